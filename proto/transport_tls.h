/* proto/transport_tls.h: TLS 1.3 for connections between a master and its workers.
 *
 * Two things: a party (who we are and whom we trust, read from PEM files once) and a
 * link (one connection's TLS state). A link does no I/O: bytes of the socket are fed in,
 * bytes for the socket are taken out, so that the transport keeps its one way in and its
 * one way out. The door to GnuTLS beside common/digest.c.
 *
 * A master shows its certificate; with a client CA it also demands one of every worker.
 * A worker checks the master's certificate against its CA (or the system's) and against the
 * name or address it dialled. Nothing below TLS 1.3, no session tickets, no renegotiation.
 *
 * A party is read-only once made and outlives its links. Links: the loop's thread.
 *
 * Tests: tests/e2e/test_e2e_tls.py.
 */
#ifndef PROTO_TRANSPORT_TLS_H
#define PROTO_TRANSPORT_TLS_H

#include "common/buf.h"

enum { TLS_PROBLEM_BYTES = 256 };

/* Nothing else is spoken, here and on the master's HTTP side. */
#define TLS_PRIORITIES "NORMAL:-VERS-ALL:+VERS-TLS1.3"

struct tls_party; /* opaque */

/* Paths of PEM files. A NULL path means: none. */
struct tls_files {
    const char *certificate, *key; /* ours: a master's is needed, a worker's perhaps asked for */
    const char *ca;                /* master: workers must show a certificate of it;
                                      worker: trusts this alone, NULL: the system's */
};

/* `problem` (TLS_PROBLEM_BYTES) says in words what is wrong with which file. ERR_INPUT: a file is
 * missing, is no PEM, or key and certificate do not belong together; ERR_NOMEM. */
TL_NODISCARD enum err tls_party_new_master(const struct tls_files *files, struct tls_party **out,
                                           char *problem);
TL_NODISCARD enum err tls_party_new_worker(const struct tls_files *files, struct tls_party **out,
                                           char *problem);
void tls_party_free(struct tls_party *p);

struct tls_link; /* opaque */

/* `host`: the name or address dialled, which the certificate must bear; NULL on the master's side.
 * ERR_NOMEM. */
TL_NODISCARD enum err tls_link_new(const struct tls_party *p, const char *host,
                                   struct tls_link **out);
void tls_link_free(struct tls_link *l);

/* Bytes from the socket, borrowed until the next tls_link_shake or tls_link_open took them. */
void tls_link_feed(struct tls_link *l, const unsigned char *data, size_t bytes);

/* One step of the handshake with what was fed. ERR_OK: done; ERR_AGAIN: more bytes are needed;
 * ERR_UNTRUSTED: no certificate, or one that is not accepted, on either side; ERR_CORRUPT: the
 * other side does not speak TLS 1.3. In all cases bytes may wait in tls_link_output. */
TL_NODISCARD enum err tls_link_shake(struct tls_link *l);

/* Decrypts all that was fed into out[capacity], which must hold it: what was fed and one record
 * (16 KiB) more. ERR_OK, also with *bytes == 0; ERR_CLOSED: the other side said that nothing
 * follows (*bytes before that); ERR_UNTRUSTED and ERR_CORRUPT as above. */
TL_NODISCARD enum err tls_link_open(struct tls_link *l, unsigned char *out, size_t capacity,
                                    size_t *bytes);

/* Encrypts behind what waits in tls_link_output. After ERR_NOMEM the link is of no use. */
TL_NODISCARD enum err tls_link_seal(struct tls_link *l, const unsigned char *data, size_t bytes);

/* Says that nothing follows. */
void tls_link_bye(struct tls_link *l);

/* What waits for the socket; the caller takes `data` away and calls buf_init on it. */
struct buf *tls_link_output(struct tls_link *l);

/* Why the last step failed, in words; "" when none has. */
const char *tls_link_problem(const struct tls_link *l);

#endif
