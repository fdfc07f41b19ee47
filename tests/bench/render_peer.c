#include "tests/bench/render_peer.h"

#include <signal.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

/* The child's side: its standard input and output become the pipes. */
static void become(const char *const argv[], const int in[2], const int out[2])
{
    (void)dup2(in[0], STDIN_FILENO);
    (void)dup2(out[1], STDOUT_FILENO);
    close(in[0]);
    close(in[1]);
    close(out[0]);
    close(out[1]);
    execv(argv[0], (char *const *)(uintptr_t)argv);
    _exit(127);
}

bool render_peer_start(struct render_peer *peer, const char *const argv[])
{
    int in[2], out[2];
    *peer = (struct render_peer){0};
    if (pipe(in) != 0)
        return false;
    if (pipe(out) != 0) {
        close(in[0]);
        close(in[1]);
        return false;
    }
    /* A peer that died is an answer that does not come, not a signal. */
    (void)signal(SIGPIPE, SIG_IGN);
    (void)fflush(NULL);
    peer->process = fork();
    if (peer->process == 0)
        become(argv, in, out);
    close(in[0]);
    close(out[1]);
    peer->to = fdopen(in[1], "w");
    peer->from = fdopen(out[0], "r");
    char line[16] = "";
    if (peer->process > 0 && peer->to && peer->from &&
        fgets(line, sizeof line, peer->from) != NULL && strcmp(line, "ready\n") == 0)
        return true;
    render_peer_stop(peer);
    return false;
}

bool render_peer_render(struct render_peer *peer, uint64_t spp, uint64_t seed, size_t pixels,
                        double *rgb, double *seconds, double *cpu_seconds)
{
    char line[128];
    if (fprintf(peer->to, "%llu %llu\n", (unsigned long long)spp, (unsigned long long)seed) < 0 ||
        fflush(peer->to) != 0 || !fgets(line, sizeof line, peer->from) ||
        sscanf(line, "%lf %lf", seconds, cpu_seconds) != 2)
        return false;
    for (size_t i = 0; i < pixels; i++) {
        float value[3];
        if (fread(value, sizeof value, 1, peer->from) != 1)
            return false;
        for (size_t k = 0; k < 3; k++)
            rgb[k * pixels + i] = (double)value[k];
    }
    return true;
}

void render_peer_stop(struct render_peer *peer)
{
    if (peer->to)
        (void)fclose(peer->to);
    if (peer->from)
        (void)fclose(peer->from);
    /* The end of its input ends it; one that hangs is ended. */
    if (peer->process > 0) {
        (void)kill(peer->process, SIGTERM);
        (void)waitpid(peer->process, NULL, 0);
    }
    *peer = (struct render_peer){0};
}
