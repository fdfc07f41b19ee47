#include "client/human.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

void human_duration(double seconds, char out[HUMAN_BYTES])
{
    if (!(seconds >= 0))
        (void)snprintf(out, HUMAN_BYTES, "-");
    else if (seconds < 9.95)
        (void)snprintf(out, HUMAN_BYTES, "%.1f s", seconds);
    else if (seconds < 59.5)
        (void)snprintf(out, HUMAN_BYTES, "%.0f s", seconds);
    else if (seconds < 3600)
        (void)snprintf(out, HUMAN_BYTES, "%d min %d s", (int)(seconds + 0.5) / 60,
                       (int)(seconds + 0.5) % 60);
    else if (seconds < 1e9)
        (void)snprintf(out, HUMAN_BYTES, "%d h %d min", (int)seconds / 3600,
                       (int)seconds % 3600 / 60);
    else
        (void)snprintf(out, HUMAN_BYTES, "years");
}

/* To two figures, but never below whole seconds. */
static double two_figures(double v)
{
    if (v < 100)
        return floor(v + 0.5);
    double unit = pow(10, floor(log10(v)) - 1);
    return floor(v / unit + 0.5) * unit;
}

static void left_text(double low_s, double high_s, const char *const units[3],
                      char out[HUMAN_BYTES])
{
    static const double sizes[3] = {1, 60, 3600};
    int u = high_s >= 2 * 3600 ? 2 : high_s >= 120 ? 1 : 0;
    double low = two_figures(low_s / sizes[u]), high = two_figures(high_s / sizes[u]);
    if (low >= high)
        (void)snprintf(out, HUMAN_BYTES, "%.0f%s", high, units[u]);
    else
        (void)snprintf(out, HUMAN_BYTES, "%.0f-%.0f%s", low, high, units[u]);
}

void human_left(double low_s, double high_s, char out[HUMAN_BYTES])
{
    static const char *const units[3] = {" s", " min", " h"};
    left_text(low_s, high_s, units, out);
}

void human_left_short(double low_s, double high_s, char out[HUMAN_BYTES])
{
    static const char *const units[3] = {"s", "m", "h"};
    left_text(low_s, high_s, units, out);
}

void human_age(double seconds, char out[HUMAN_BYTES])
{
    if (!(seconds >= 0))
        (void)snprintf(out, HUMAN_BYTES, "-");
    else if (seconds < 60)
        (void)snprintf(out, HUMAN_BYTES, "%.0fs", floor(seconds));
    else if (seconds < 3600)
        (void)snprintf(out, HUMAN_BYTES, "%.0fm", floor(seconds / 60));
    else if (seconds < 86400)
        (void)snprintf(out, HUMAN_BYTES, "%.0fh", floor(seconds / 3600));
    else
        (void)snprintf(out, HUMAN_BYTES, "%.0fd", floor(seconds / 86400));
}

void human_rays(double rays_s, char out[HUMAN_BYTES])
{
    if (!(rays_s > 0))
        (void)snprintf(out, HUMAN_BYTES, "-");
    else if (rays_s < 1e6)
        (void)snprintf(out, HUMAN_BYTES, "%.0f kray/s", rays_s / 1e3);
    else if (rays_s < 9.95e6)
        (void)snprintf(out, HUMAN_BYTES, "%.1f Mray/s", rays_s / 1e6);
    else if (rays_s < 1e9)
        (void)snprintf(out, HUMAN_BYTES, "%.0f Mray/s", rays_s / 1e6);
    else
        (void)snprintf(out, HUMAN_BYTES, "%.1f Gray/s", rays_s / 1e9);
}

void human_bytes(double bytes, char out[HUMAN_BYTES])
{
    if (bytes < 1e3)
        (void)snprintf(out, HUMAN_BYTES, "%.0f B", bytes);
    else if (bytes < 1e6)
        (void)snprintf(out, HUMAN_BYTES, "%.1f kB", bytes / 1e3);
    else if (bytes < 1e9)
        (void)snprintf(out, HUMAN_BYTES, "%.1f MB", bytes / 1e6);
    else
        (void)snprintf(out, HUMAN_BYTES, "%.2f GB", bytes / 1e9);
}

void human_count(double count, char out[HUMAN_BYTES])
{
    char digits[32];
    int n = snprintf(digits, sizeof digits, "%.0f", count < 0 || count > 1e18 ? 0 : count);
    int used = 0;
    for (int i = 0; i < n; i++) {
        if (i > 0 && (n - i) % 3 == 0)
            out[used++] = ',';
        out[used++] = digits[i];
    }
    out[used] = '\0';
}

void human_things(double count, const char *one, const char *more, char out[HUMAN_BYTES])
{
    human_count(count, out);
    size_t used = strlen(out);
    (void)snprintf(out + used, HUMAN_BYTES - used, " %s", count == 1 ? one : more);
}

void human_error(double v, char out[HUMAN_BYTES])
{
    if (isnan(v))
        (void)snprintf(out, HUMAN_BYTES, "-");
    else if (v == 0 || (v >= 0.001 && v < 1000))
        (void)snprintf(out, HUMAN_BYTES, v >= 0.1 ? "%.3f" : v >= 0.01 ? "%.4f" : "%.5f", v);
    else
        (void)snprintf(out, HUMAN_BYTES, "%.1e", v);
}
