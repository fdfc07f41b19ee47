#include "worker/render/sky_batch.h"

#include "worker/render/lanes.h"

void sky_batch_draw(const struct environment *e, struct sky_batch *b)
{
    static sky_loop *const loops[LANES_LEVELS] = {sky_draw_sse2, sky_draw_avx2, sky_draw_avx512};
    loops[lanes_level()](e, b);
}

void sky_batch_look(const struct environment *e, struct sky_batch *b)
{
    static sky_loop *const loops[LANES_LEVELS] = {sky_look_sse2, sky_look_avx2, sky_look_avx512};
    loops[lanes_level()](e, b);
}
