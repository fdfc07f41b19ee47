/* worker/scene/scene_locks.h: the locks under which render threads build trees of objects that no
 * ray had met before (accel_lazy.h). Objects share them by number. Owned by the scene; any thread
 * may lock. */
#ifndef WORKER_SCENE_SCENE_LOCKS_H
#define WORKER_SCENE_SCENE_LOCKS_H

#include "worker/render/accel_lazy.h"

struct scene_locks; /* opaque */

struct scene_locks *scene_locks_new(void); /* NULL: no memory */
void scene_locks_free(struct scene_locks *l);
struct accel_locks scene_locks_of(struct scene_locks *l);

#endif
