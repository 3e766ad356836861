/* Timers: which node each is of, so that none calls a node that is about to be unloaded.
 *
 * A container of rclcpp with several threads destroys a node in one of them while another may call it, which ends the
 * process with all nodes in it. So from the time that a node LEAVES, none of its timers calls it, and it takes no message on
 * its ports. A timer is of the node that its thread was loading, or in a callback of, when it was initialized; one of
 * another thread is not known, and goes on.
 */
#include "gate.h"

/* How many timers are known at once. */
#define TIMERS 1024u
#define GONE ((const void *)known)

static struct known {
  _Atomic(const void *) timer; /* NULL: never used; GONE: no longer */
  _Atomic unsigned me;         /* index + 1 of its node in the page */
  bool cancelled;              /* since that node leaves. With `lock` */
} known[TIMERS];

/* In a callback of which node this thread is, as index + 1; 0: of none that is known. */
static _Thread_local unsigned called;

void begin_call(unsigned me)
{
  called = me;
}

bool has_to_leave(unsigned me)
{
  return me && atomic_load_explicit(&page->nodes[me - 1].used, memory_order_acquire) & LEAVES;
}

static struct known *probed(const void *timer, unsigned step)
{
  return &known[((unsigned)(((uintptr_t)timer >> 4) * UINT32_C(2654435761)) + step) % TIMERS];
}

static struct known *find_timer(const void *timer)
{
  for (unsigned step = 0; page && step < TIMERS; step++) {
    struct known *found = probed(timer, step);
    const void *of = atomic_load_explicit(&found->timer, memory_order_acquire);
    if (of == timer || !of)
      return of ? found : NULL;
  }
  return NULL;
}

static int add_timer(const void *timer, int result)
{
  unsigned loaded = page ? being_loaded() : 0, me = loaded ? loaded : called;
  if (result != 0 || !me)
    return result;
  pthread_mutex_lock(&lock);
  struct known *place = find_timer(timer); /* rcl_timer_init calls rcl_timer_init2 */
  for (unsigned step = 0; !place && step < TIMERS; step++) {
    struct known *other = probed(timer, step);
    const void *of = atomic_load(&other->timer);
    if (!of || of == GONE)
      place = other;
  }
  if (place) {
    atomic_store(&place->me, me);
    place->cancelled = false;
    atomic_store_explicit(&place->timer, timer, memory_order_release);
  }
  pthread_mutex_unlock(&lock);
  return result;
}

/* The timers of a node that does not leave after all call it again. With `lock`. */
void resume_timers(void)
{
  for (unsigned index = 0; index < TIMERS; index++) {
    unsigned me = atomic_load(&known[index].me);
    const void *timer = atomic_load(&known[index].timer);
    if (!timer || timer == GONE || !known[index].cancelled || has_to_leave(me) || !(page->nodes[me - 1].used & IN_USE))
      continue;
    known[index].cancelled = false;
    real_rcl_timer_reset()((void *)timer);
  }
}

/* Whether the timer may not call its node. It is cancelled, since the executor would find it ready again and again. */
static bool cancels(void *timer)
{
  struct known *found = find_timer(timer);
  unsigned me = found ? atomic_load(&found->me) : 0;
  end_input();
  begin_call(me);
  if (!has_to_leave(me) || !real_rcl_timer_cancel() || !real_rcl_timer_reset())
    return false;
  pthread_mutex_lock(&lock);
  found->cancelled = true;
  real_rcl_timer_cancel()(timer);
  pthread_mutex_unlock(&lock);
  return true;
}

EXPORT int rcl_timer_init(void *timer, void *clock, void *context, int64_t period, void *callback, allocator memory)
{
  return add_timer(timer, real_rcl_timer_init()(timer, clock, context, period, callback, memory));
}

EXPORT int rcl_timer_init2(void *timer, void *clock, void *context, int64_t period, void *callback, allocator memory,
                           bool starts)
{
  return add_timer(timer, real_rcl_timer_init2()(timer, clock, context, period, callback, memory, starts));
}

EXPORT int rcl_timer_fini(void *timer)
{
  struct known *found = find_timer(timer);
  if (found) {
    pthread_mutex_lock(&lock);
    atomic_store_explicit(&found->timer, GONE, memory_order_release);
    pthread_mutex_unlock(&lock);
  }
  return real_rcl_timer_fini()(timer);
}

EXPORT int rcl_timer_call(void *timer)
{
  return cancels(timer) ? TIMER_CANCELED : real_rcl_timer_call()(timer);
}

EXPORT int rcl_timer_call_with_info(void *timer, void *info)
{
  return cancels(timer) ? TIMER_CANCELED : real_rcl_timer_call_with_info()(timer, info);
}
