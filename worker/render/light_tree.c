#include "worker/render/light_tree.h"

#include "common/err.h"

/* Cosine and sine of an angle in [0, pi]. */
struct angle {
    double cosine, sine;
};

/* a - b, or 0 if b is larger. */
static struct angle angle_less(struct angle a, struct angle b)
{
    if (a.cosine >= b.cosine)
        return (struct angle){1, 0};
    return (struct angle){a.cosine * b.cosine + a.sine * b.sine,
                          a.sine * b.cosine - a.cosine * b.sine};
}

static struct angle angle_of(double cosine)
{
    double c = cosine < -1 ? -1 : cosine > 1 ? 1 : cosine;
    return (struct angle){c, sqrt(1 - c * c)};
}

/* What a spot's fall-off leaves between its angles is a guess; this much at least. */
static const double COSINE_LEAST = 0.05;

/* About what the node's lights send to p, and onto a surface of normal n. */
static double importance(const struct light_node *m, vec3 p, vec3 n)
{
    vec3 d = v3_sub(p, m->center);
    double distance2 = v3_dot(d, d);
    /* From within the sphere its lights are in every direction. */
    if (!(distance2 > m->radius2))
        return m->radius2 > 0 ? m->intensity / m->radius2 : 0;
    double inverse = 1 / sqrt(distance2), cos2 = 1 - m->radius2 * inverse * inverse;
    struct angle wide = {sqrt(cos2 > 0 ? cos2 : 0), m->radius * inverse};
    double shining = 1, facing = 1;
    if (m->cos_o > -1) {
        struct angle off = angle_of(v3_dot(m->axis, d) * inverse);
        off = angle_less(off, (struct angle){m->cos_o, m->sin_o});
        shining = angle_less(off, wide).cosine;
        if (!(shining > m->cos_e))
            return 0;
        shining = shining > COSINE_LEAST ? shining : COSINE_LEAST;
    }
    if (v3_abs_max(n) > 0) {
        facing = angle_less(angle_of(-v3_dot(n, d) * inverse), wide).cosine;
        if (!(facing > 0))
            return 0;
    }
    return m->intensity * shining * facing * inverse * inverse;
}

/* The share of the first child of an inner node; below 0 where neither sends anything. */
static double first_share(const struct light_tree *t, uint32_t node, vec3 p, vec3 n)
{
    double first = importance(&t->nodes[node + 1], p, n);
    double second = importance(&t->nodes[t->nodes[node].right], p, n);
    double sum = first + second;
    return sum > 0 ? first / sum : -1;
}

/* The draws begin..end-1, all of which have come to `node`. */
struct descent {
    uint32_t node, begin, end;
};

/* Sends draws on to a child, whose share of [0,1) begins at `from`. */
static void enter_child(double from, double share, uint32_t begin, uint32_t end, double u[],
                        double probabilities[])
{
    static const double below_one = 1.0 - 1.0 / 9007199254740992.0;
    for (uint32_t k = begin; k < end; k++) {
        double inside = (u[k] - from) / share;
        u[k] = inside < below_one ? inside : below_one;
        probabilities[k] *= share;
    }
}

void light_tree_draw_many(const struct light_tree *t, vec3 p, vec3 n, uint32_t count,
                          const double u[], uint32_t lights[], double probabilities[])
{
    struct descent waiting[LIGHT_TREE_DRAWS_MAX], at = {0, 0, count};
    double rest[LIGHT_TREE_DRAWS_MAX];
    uint32_t waiting_count = 0;
    TL_DASSERT(count > 0 && count <= LIGHT_TREE_DRAWS_MAX);
    for (uint32_t k = 0; k < count; k++) {
        rest[k] = u[k];
        probabilities[k] = 1;
    }
    for (;;) {
        uint32_t right = t->nodes[at.node].right, split = at.begin;
        double share = right ? first_share(t, at.node, p, n) : -1;
        if (share < 0) {
            for (uint32_t k = at.begin; k < at.end; k++)
                lights[k] = right ? UINT32_MAX : t->nodes[at.node].light;
            if (waiting_count == 0)
                return;
            at = waiting[--waiting_count];
            continue;
        }
        while (split < at.end && rest[split] < share)
            split++;
        enter_child(0, share, at.begin, split, rest, probabilities);
        enter_child(share, 1 - share, split, at.end, rest, probabilities);
        struct descent first = {at.node + 1, at.begin, split}, second = {right, split, at.end};
        bool both = split > at.begin && split < at.end;
        if (both)
            waiting[waiting_count++] = second;
        at = split > at.begin ? first : second;
    }
}

uint32_t light_tree_draw(const struct light_tree *t, vec3 p, vec3 n, double u, double *probability)
{
    uint32_t light;
    light_tree_draw_many(t, p, n, 1, &u, &light, probability);
    return light;
}

double light_tree_probability(const struct light_tree *t, uint32_t light, vec3 p, vec3 n)
{
    double probability = t->leaf_of[light] == UINT32_MAX ? 0 : 1;
    for (uint32_t node = probability > 0 ? t->leaf_of[light] : 0; node != 0;
         node = t->nodes[node].parent) {
        uint32_t parent = t->nodes[node].parent;
        double share = first_share(t, parent, p, n);
        if (share < 0)
            return 0;
        probability *= node == parent + 1 ? share : 1 - share;
    }
    return probability;
}
