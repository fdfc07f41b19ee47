/* A JSON value back as text, for the parts of a body that have a reader of their own. */
#include <inttypes.h>
#include <math.h>

#include "common/mem.h"
#include "common/json_put.h"
#include "master/http_body.h"

/* The value after `v` in a walk of the tree under `top`; closes what ends on the way. */
static const struct json *step(struct buf *b, const struct json *v, const struct json *top)
{
    while (v != top && !v->next) {
        v = v->parent;
        buf_put_u8(b, v->type == JSON_ARRAY ? ']' : '}');
    }
    if (v == top)
        return NULL;
    buf_put_u8(b, ',');
    return v->next;
}

static void put_scalar(struct buf *b, const struct json *v)
{
    switch (v->type) {
    case JSON_NULL:
        buf_printf(b, "null");
        break;
    case JSON_BOOL:
        buf_printf(b, v->truth ? "true" : "false");
        break;
    case JSON_NUMBER:
        if (v->is_whole)
            buf_printf(b, "%" PRIu64, v->whole);
        else if (isfinite(v->number))
            json_put_number(b, v->number);
        else
            buf_printf(b, "1e999"); /* stays what its reader will refuse */
        break;
    case JSON_STRING:
        json_put_text(b, v->text);
        break;
    case JSON_ARRAY:
        buf_printf(b, v->first ? "[" : "[]");
        break;
    case JSON_OBJECT:
        buf_printf(b, v->first ? "{" : "{}");
        break;
    }
}

char *http_json_text(const struct json *top)
{
    struct buf b;
    buf_init(&b);
    for (const struct json *v = top; v;) {
        if (v != top && v->key) {
            json_put_text(&b, v->key);
            buf_put_u8(&b, ':');
        }
        put_scalar(&b, v);
        bool nested = (v->type == JSON_ARRAY || v->type == JSON_OBJECT) && v->first;
        v = nested ? v->first : step(&b, v, top);
    }
    buf_put_u8(&b, '\0');
    if (buf_status(&b) != ERR_OK) {
        buf_release(&b);
        return NULL;
    }
    return (char *)b.data;
}
