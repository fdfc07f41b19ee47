/* The page and the API's description: files of web/ as bytes of the program. */
#include <microhttpd.h>

#include "master/http_impl.h"

/* Names `symbol` and `symbol_end` around the bytes of a file of web/. */
#define EMBED(symbol, file)                                                                        \
    __asm__(".pushsection .rodata\n"                                                               \
            ".global " #symbol "\n" #symbol ":\n"                                                  \
            ".incbin \"" TILERY_WEB_DIR "/" file "\"\n"                                            \
            ".global " #symbol "_end\n" #symbol "_end:\n"                                          \
            ".byte 0\n"                                                                            \
            ".popsection\n");                                                                      \
    extern const unsigned char symbol[], symbol##_end[]

EMBED(web_index, "index.html");
EMBED(web_script, "app.js");
EMBED(web_style, "style.css");
EMBED(web_openapi, "openapi.json");

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

void http_get_style(struct request *r)
{
    reply_file(r, "text/css; charset=utf-8", web_style, web_style_end);
}

void http_get_openapi(struct request *r)
{
    reply_file(r, "application/json", web_openapi, web_openapi_end);
}
