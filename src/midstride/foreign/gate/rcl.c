/* The real functions of ROS, and how the library has memory for messages. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdatomic.h>
#include <stdlib.h>

/* The real functions, each found when it is first called: librcl may be loaded after this library. */
static void *real(_Atomic(void *) *known, const char *name)
{
  void *found = atomic_load_explicit(known, memory_order_acquire);
  if (found)
    return found;
  found = dlsym(RTLD_NEXT, name);
  /* Else loaded by an extension module of Python, so not in the global scope. What it is linked with is searched, too: the
   * functions of the middleware are in a library of another name on each installation. */
  static const char *const libraries[] = {"librcl.so", "librcl_action.so", "librclcpp.so"};
  for (unsigned index = 0; !found && index < 3; index++) {
    void *handle = dlopen(libraries[index], RTLD_NOW | RTLD_NOLOAD);
    if (handle) {
      found = dlsym(handle, name);
      dlclose(handle);
    }
  }
  if (found)
    atomic_store_explicit(known, found, memory_order_release);
  return found;
}

#define REAL_CALLED(result, name, symbol, ...)                                                                           \
  result (*real_##name(void))(__VA_ARGS__)                                                                               \
  {                                                                                                                      \
    static _Atomic(void *) known;                                                                                        \
    return (result(*)(__VA_ARGS__))real(&known, symbol);                                                                  \
  }

#pragma GCC visibility push(hidden)
#include "rcl.h"
#pragma GCC visibility pop

static void *allocate(size_t size, void *state)
{
  (void)state;
  return malloc(size);
}

static void deallocate(void *memory, void *state)
{
  (void)state;
  free(memory);
}

static void *reallocate(void *memory, size_t size, void *state)
{
  (void)state;
  return realloc(memory, size);
}

static void *zero_allocate(size_t number, size_t size, void *state)
{
  (void)state;
  return calloc(number, size);
}

const allocator heap = {allocate, deallocate, reallocate, zero_allocate, NULL};
