/* What container.c and the libraries that it loads share: a composable node on rcl alone. */
#include "rcl_require.h"

#include <stdbool.h>

/* `node` is initialized. `parameters`: of the request. After `period` ns, and again each time, the container calls
 * `tick`; `end` is called once, and says whether the node may be finalized; else the container calls `stay` once it has
 * answered. */
struct composable {
  rcl_node_t node;
  void *state;
  long long period, slot;
  void (*tick)(struct composable *self);
  bool (*end)(struct composable *self);
  void (*stay)(struct composable *self);
};

/* What a library exports as `create`: fills in `self` and returns NULL, or why that cannot be done. `number_of`: the
 * value of a parameter of the request, or `otherwise`. */
typedef const char *create_function(struct composable *self, const char *plugin,
                                    double (*number_of)(const char *name, double otherwise));
