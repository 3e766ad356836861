/* Executors that wait: they are woken for a request that is held, of which the middleware does not know. */
#include "serving.h"

#include <string.h>

/* How long a wait without a guard condition, which cannot be ended, lasts while requests are held (ns). */
#define SHORT_WAIT INT64_C(10000000)

/* The executors that wait, each with a guard condition that ends its wait; NULL where it has none. With `lock`. */
struct waiting {
  struct waiting *next;
  const void *guard;
};
static struct waiting *waits;

void announce(struct entry *entry)
{
  for (struct waiting *waiting = waits; waiting; waiting = waiting->next)
    if (waiting->guard)
      real_rcl_trigger_guard_condition()(waiting->guard);
  if (!entry->callback)
    return;
  size_t number = 0;
  struct requests *requests = requests_of(entry->me);
  for (struct held *held = entry->held; held; held = held->next)
    if (!held->announced && (held->claimed || turn_with_held(requests, entry, held) != WAIT)) {
      held->announced = true;
      number++;
    }
  if (number)
    entry->callback(entry->context, number);
}

/* Since when no executor waits for requests to a server; 0: one begins to. */
static void note_busy(struct entry *entry, int64_t since)
{
  if (entry && !entry->callback)
    atomic_store_explicit(&entry->port->busy, since, memory_order_relaxed);
}

/* Servers with a request that is held are ready once the node is to answer it. */
EXPORT int rcl_wait(struct wait_set *set, int64_t timeout)
{
  end_input();
  if (!page || !set || !set->impl || !set->service_count)
    return real_rcl_wait()(set, timeout);
  for (size_t index = 0; index < set->service_count; index++)
    note_busy(find_server(set->services[index]), 0);
  if (set->service_count > ENTRIES)
    return real_rcl_wait()(set, timeout);
  const void *services[ENTRIES];
  size_t count = set->service_count;
  memcpy(services, set->services, count * sizeof *services);
  const void *keys[ENTRIES]; /* a server may be gone after the wait */
  for (size_t index = 0; index < count; index++)
    keys[index] = server_key(services[index]);
  struct waiting own = {0};
  for (size_t index = 0; index < set->guard_count && !own.guard; index++)
    own.guard = set->guards[index];
  bool shortened = false;
  pthread_mutex_lock(&lock);
  for (size_t index = 0; index < count; index++) {
    struct entry *entry = keyed(keys[index]);
    if (is_due(entry))
      timeout = 0;
    else if (entry && atomic_load(&entry->holding))
      shortened = shortened || (!own.guard && (timeout < 0 || timeout > SHORT_WAIT));
  }
  if (shortened && timeout != 0)
    timeout = SHORT_WAIT;
  own.next = waits;
  waits = &own;
  pthread_mutex_unlock(&lock);
  int result = real_rcl_wait()(set, timeout);
  int64_t now = now_ns();
  for (size_t index = 0; index < count; index++)
    note_busy(keyed(keys[index]), now);
  pthread_mutex_lock(&lock);
  struct waiting **place = &waits;
  while (*place != &own)
    place = &(*place)->next;
  *place = own.next;
  bool ready = false;
  for (size_t index = 0; index < count && (result == 0 || result == TIMED_OUT); index++) {
    struct entry *entry = set->services[index] ? NULL : keyed(keys[index]);
    /* A shortened wait has not timed out for its caller, who takes, finds no request, and waits again. */
    if (is_due(entry) || (entry && shortened && result == TIMED_OUT && atomic_load(&entry->holding))) {
      set->services[index] = services[index];
      ready = true;
    }
  }
  pthread_mutex_unlock(&lock);
  return ready ? 0 : result;
}
