/* The page, the API's description, what errors mean: files of web/ and docs/ as bytes of the
 * program. */
#include <microhttpd.h>
#include <string.h>

#include "master/http_impl.h"

/* Names `symbol` and `symbol_end` around the bytes of a file. */
#define EMBED(symbol, path)                                                                        \
    __asm__(".pushsection .rodata\n"                                                               \
            ".global " #symbol "\n" #symbol ":\n"                                                  \
            ".incbin \"" path "\"\n"                                                               \
            ".global " #symbol "_end\n" #symbol "_end:\n"                                          \
            ".byte 0\n"                                                                            \
            ".popsection\n");                                                                      \
    extern const unsigned char symbol[], symbol##_end[]

EMBED(web_index, TILERY_WEB_DIR "/index.html");
EMBED(web_script, TILERY_WEB_DIR "/app.js");
EMBED(web_viewer, TILERY_WEB_DIR "/viewer.js");
EMBED(web_icon, TILERY_WEB_DIR "/icon.svg");
EMBED(web_style, TILERY_WEB_DIR "/style.css");
EMBED(web_openapi, TILERY_WEB_DIR "/openapi.json");
EMBED(docs_errors, TILERY_DOCS_DIR "/ERRORS.md");

static void reply_file(struct request *r, const char *type, const unsigned char *begin,
                       const unsigned char *end)
{
    struct buf b;
    buf_init(&b);
    buf_put(&b, begin, (size_t)(end - begin));
    request_reply(r, MHD_HTTP_OK, type, &b);
}

void http_get_page(struct request *r)
{
    reply_file(r, "text/html; charset=utf-8", web_index, web_index_end);
}

void http_get_script(struct request *r)
{
    reply_file(r, "text/javascript; charset=utf-8", web_script, web_script_end);
}

void http_get_viewer(struct request *r)
{
    reply_file(r, "text/javascript; charset=utf-8", web_viewer, web_viewer_end);
}

void http_get_icon(struct request *r)
{
    reply_file(r, "image/svg+xml", web_icon, web_icon_end);
}

void http_get_style(struct request *r)
{
    reply_file(r, "text/css; charset=utf-8", web_style, web_style_end);
}

void http_get_openapi(struct request *r)
{
    reply_file(r, "application/json", web_openapi, web_openapi_end);
}

/* --- What errors mean: docs/ERRORS.md, of which headings and paragraphs are all the markup ---- */

static void put_escaped(struct buf *b, const char *text, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++) {
        if (text[i] == '<')
            buf_printf(b, "&lt;");
        else if (text[i] == '&')
            buf_printf(b, "&amp;");
        else
            buf_put_u8(b, (unsigned char)text[i]);
    }
}

/* One line; a heading of the third rank is the place that a problem's `type` names. */
static void put_line(struct buf *b, const char *line, size_t bytes)
{
    size_t rank = 0;
    while (rank < bytes && line[rank] == '#')
        rank++;
    if (bytes == 0) {
        buf_printf(b, "<p>\n");
    } else if (rank == 0 || rank > 3 || rank + 1 >= bytes) {
        put_escaped(b, line, bytes);
        buf_put_u8(b, '\n');
    } else {
        const char *text = line + rank + 1;
        size_t text_bytes = bytes - rank - 1;
        buf_printf(b, "<h%d", (int)rank);
        if (rank == 3) {
            buf_printf(b, " id=\"");
            put_escaped(b, text, text_bytes);
            buf_put_u8(b, '"');
        }
        buf_put_u8(b, '>');
        put_escaped(b, text, text_bytes);
        buf_printf(b, "</h%d>\n", (int)rank);
    }
}

void http_get_errors(struct request *r)
{
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
                   "<title>Tilery: errors</title></head><body>\n");
    const char *at = (const char *)docs_errors, *end = (const char *)docs_errors_end;
    while (at < end) {
        const char *stop = memchr(at, '\n', (size_t)(end - at));
        size_t bytes = (size_t)((stop ? stop : end) - at);
        put_line(&b, at, bytes);
        at += bytes + (stop != NULL);
    }
    buf_printf(&b, "</body></html>\n");
    request_reply(r, MHD_HTTP_OK, "text/html; charset=utf-8", &b);
}
