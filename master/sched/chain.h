/* master/sched/chain.h: doubly linked lists of table slots.
 *
 * The links live in an array beside the table (one array for each kind of list a
 * slot may be in), so that lists need no memory of their own. Adding a slot that
 * is in a list, or removing one that is not, is a bug. Pure.
 */
#ifndef MASTER_SCHED_CHAIN_H
#define MASTER_SCHED_CHAIN_H

#include "common/err.h"

#define SLOT_NONE UINT32_MAX

struct link {
    uint32_t prev, next;
};

struct chain {
    uint32_t head, tail, count;
};

static inline void chain_init(struct chain *c)
{
    c->head = c->tail = SLOT_NONE;
    c->count = 0;
}

static inline void chain_push(struct chain *c, struct link *links, uint32_t slot)
{
    links[slot] = (struct link){.prev = c->tail, .next = SLOT_NONE};
    if (c->tail == SLOT_NONE)
        c->head = slot;
    else
        links[c->tail].next = slot;
    c->tail = slot;
    c->count++;
}

static inline void chain_push_front(struct chain *c, struct link *links, uint32_t slot)
{
    links[slot] = (struct link){.prev = SLOT_NONE, .next = c->head};
    if (c->head == SLOT_NONE)
        c->tail = slot;
    else
        links[c->head].prev = slot;
    c->head = slot;
    c->count++;
}

static inline void chain_remove(struct chain *c, struct link *links, uint32_t slot)
{
    TL_ASSERT(c->count > 0);
    struct link l = links[slot];
    if (l.prev == SLOT_NONE) {
        TL_ASSERT(c->head == slot);
        c->head = l.next;
    } else {
        links[l.prev].next = l.next;
    }
    if (l.next == SLOT_NONE) {
        TL_ASSERT(c->tail == slot);
        c->tail = l.prev;
    } else {
        links[l.next].prev = l.prev;
    }
    c->count--;
}

#endif
