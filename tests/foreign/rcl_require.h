/* What nodes on rcl alone share. A call of rcl that has failed ends the program. */
#include <rcl/error_handling.h>
#include <rcl/rcl.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static inline void require(rcl_ret_t result, const char *what)
{
  if (result == RCL_RET_OK)
    return;
  fprintf(stderr, "%s: %s\n", what, rcl_get_error_string().str);
  exit(1);
}

/* A context of its arguments, and a node, which may be named otherwise by these. */
static inline void start_node(int count, char **arguments, const char *name, rcl_context_t *context, rcl_node_t *node)
{
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  rcl_node_options_t node_options = rcl_node_get_default_options();
  *context = rcl_get_zero_initialized_context();
  *node = rcl_get_zero_initialized_node();
  require(rcl_init_options_init(&options, rcl_get_default_allocator()), "options");
  require(rcl_init(count, (const char *const *)arguments, &options, context), "init");
  require(rcl_node_init(node, name, "", context, &node_options), "node");
}

/* What a node calls itself in what it writes: its instance, as of two in a hand-over the name is one. */
static inline const char *instance_of(const rcl_node_t *node)
{
  const char *instance = getenv("MIDSTRIDE_INSTANCE");
  return instance ? instance : rcl_node_get_name(node);
}

/* On the monotonic clock (ns). */
static inline long long now(void)
{
  struct timespec at;
  clock_gettime(CLOCK_MONOTONIC, &at);
  return at.tv_sec * 1000000000ll + at.tv_nsec;
}
