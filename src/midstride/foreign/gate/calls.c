/* What calls a node: so that nothing does any more once it is about to be unloaded.
 *
 * A container of rclcpp with several threads destroys a node in one of them while another may call it, which ends the
 * process with all nodes in it. So from the time that a node LEAVES, nothing of it is taken: its timers pass without a call,
 * messages and responses are dropped, and requests are held, in case it stays after all. And the page says how many threads
 * are in a call of it that has begun before.
 *
 * A timer is of the node that its thread was loading, or in a callback of, when it was initialized; one of another thread is
 * not known, and goes on.
 */
#include "gate.h"

/* How many timers, clients, and subscriptions without a port, are known at once. */
#define CALLERS 4096u
#define GONE ((const void *)callers)

static struct caller {
  _Atomic(const void *) what; /* NULL: never used; GONE: no longer */
  _Atomic unsigned me;        /* index + 1 of its node in the page */
} callers[CALLERS];

/* -- calls -------------------------------------------------------------------------------------------------------------- */

/* This thread is in a call of which node, as index + 1; 0: of none that is known. `counted`: and is counted there.
 * `callbacks`: in how many callbacks of rclcpp it is, one in another. */
static _Thread_local unsigned called, counted, callbacks;

static void count_in(unsigned me)
{
  if (me == counted)
    return;
  if (me)
    atomic_fetch_add(&page->nodes[me - 1].calls, 1);
  if (counted) {
    _Atomic uint32_t *calls = &page->nodes[counted - 1].calls;
    uint32_t before = atomic_load(calls);
    while (before && !atomic_compare_exchange_weak(calls, &before, before - 1))
      ;
  }
  counted = me;
}

void begin_call(unsigned me)
{
  called = me;
  if (page && !callbacks) /* else this call is in another one, which goes on after it */
    count_in(me && &page->nodes[me - 1] != node ? me : 0);
}

bool has_to_leave(unsigned me)
{
  if (!me)
    return false;
  struct node *owner = &page->nodes[me - 1];
  uint32_t used = atomic_load(&owner->used); /* not before this thread is counted, as the manager looks in the other order */
  return used & LEAVES || (!used && owner != node); /* a container has said that it has unloaded it */
}

/* Of tracetools: rclcpp calls them before and after each callback of a subscription, a timer or a server. Without them, a call
 * has ended when its thread waits, or takes something else. */
EXPORT void ros_trace_callback_start(const void *callback, bool within)
{
  callbacks++;
  if (real_ros_trace_callback_start())
    real_ros_trace_callback_start()(callback, within);
}

EXPORT void ros_trace_callback_end(const void *callback)
{
  if (callbacks && --callbacks == 0 && page)
    count_in(0);
  if (real_ros_trace_callback_end())
    real_ros_trace_callback_end()(callback);
}

/* -- what calls ----------------------------------------------------------------------------------------------------------- */

static struct caller *probed(const void *what, unsigned step)
{
  return &callers[((unsigned)(((uintptr_t)what >> 4) * UINT32_C(2654435761)) + step) % CALLERS];
}

static struct caller *find_caller(const void *what)
{
  for (unsigned step = 0; page && step < CALLERS; step++) {
    struct caller *found = probed(what, step);
    const void *known = atomic_load_explicit(&found->what, memory_order_acquire);
    if (known == what || !known)
      return known ? found : NULL;
  }
  return NULL;
}

unsigned called_by(const void *what)
{
  struct caller *found = find_caller(what);
  return found ? atomic_load(&found->me) : 0;
}

/* With `lock`. */
static void add_caller(const void *what, unsigned me)
{
  struct caller *place = find_caller(what); /* rcl_timer_init calls rcl_timer_init2 */
  for (unsigned step = 0; !place && step < CALLERS; step++) {
    struct caller *other = probed(what, step);
    const void *known = atomic_load(&other->what);
    if (!known || known == GONE)
      place = other;
  }
  if (!place)
    return;
  atomic_store(&place->me, me);
  atomic_store_explicit(&place->what, what, memory_order_release);
}

void note_caller(const void *what, const void *owner)
{
  if (!page)
    return;
  pthread_mutex_lock(&lock);
  unsigned me = node_of(owner);
  if (&page->nodes[me - 1] != node) /* the node that the process was started as ends with it */
    add_caller(what, me);
  pthread_mutex_unlock(&lock);
}

void forget_caller(const void *what)
{
  struct caller *found = find_caller(what);
  if (!found)
    return;
  pthread_mutex_lock(&lock);
  unsigned index = (unsigned)(found - callers);
  const void *next = atomic_load(&callers[(index + 1) % CALLERS].what), *left = next ? GONE : NULL;
  do { /* where nothing is looked for behind them, those that are gone are not passed any more */
    atomic_store_explicit(&callers[index].what, left, memory_order_release);
    index = (index + CALLERS - 1) % CALLERS;
  } while (!left && atomic_load(&callers[index].what) == GONE);
  pthread_mutex_unlock(&lock);
}

/* -- timers --------------------------------------------------------------------------------------------------------------- */

static int add_timer(const void *timer, int result)
{
  unsigned loaded = page ? being_loaded() : 0, me = loaded ? loaded : called;
  if (result != 0 || !me)
    return result;
  pthread_mutex_lock(&lock);
  add_caller(timer, me);
  pthread_mutex_unlock(&lock);
  return result;
}

/* Whether the timer may not call its node. */
static bool must_pass(void *timer)
{
  unsigned me = called_by(timer);
  end_input();
  begin_call(me);
  return has_to_leave(me);
}

/* Its time passes without a call, else the executor would find it ready again and again. It is not cancelled: to resume it
 * later, by rcl_timer_reset, calls the executor, and that may wait for a thread that waits for `lock`. The callback of a timer
 * in C is called within librcl, so it is taken out meanwhile; rclcpp and rclpy have none there. */
static int pass(void *timer)
{
  int64_t info[2]; /* rcl_timer_call_info_t */
  pthread_mutex_lock(&lock);
  void *callback = real_rcl_timer_exchange_callback() ? real_rcl_timer_exchange_callback()(timer, NULL) : NULL;
  /* rcl_timer_call calls the other one, and this library may see that: not with `lock`. */
  int result = real_rcl_timer_call_with_info() ? real_rcl_timer_call_with_info()(timer, info) : real_rcl_timer_call()(timer);
  if (callback)
    real_rcl_timer_exchange_callback()(timer, callback);
  pthread_mutex_unlock(&lock);
  return result == 0 ? TIMER_CANCELED : result;
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
  forget_caller(timer);
  return real_rcl_timer_fini()(timer);
}

static int timer_result(int result)
{
  if (result != 0)
    begin_call(0);
  return result;
}

EXPORT int rcl_timer_call(void *timer)
{
  return timer_result(must_pass(timer) ? pass(timer) : real_rcl_timer_call()(timer));
}

EXPORT int rcl_timer_call_with_info(void *timer, void *info)
{
  return timer_result(must_pass(timer) ? pass(timer) : real_rcl_timer_call_with_info()(timer, info));
}

/* -- clients -------------------------------------------------------------------------------------------------------------- */

EXPORT int rcl_client_init(void *client, const void *owner, const void *type, const char *name, const void *options)
{
  int result = real_rcl_client_init()(client, owner, type, name, options);
  if (result == 0)
    note_caller(client, owner);
  return result;
}

EXPORT int rcl_client_fini(void *client, void *owner)
{
  forget_caller(client);
  return real_rcl_client_fini()(client, owner);
}

/* This thread is about to take a response; the node of its client, as index + 1. */
static unsigned begin_response(const void *client)
{
  unsigned me = called_by(client);
  end_input();
  begin_call(me);
  return me;
}

/* The result of taking a response: where the node leaves, as if there had been none. */
static int response_result(unsigned me, int result)
{
  bool leaves = has_to_leave(me);
  if (leaves || result != 0)
    begin_call(0);
  return leaves && result == 0 ? NO_RESPONSE : result;
}

EXPORT int rcl_take_response(const void *client, struct request_id *id, void *response)
{
  unsigned me = begin_response(client);
  return response_result(me, real_rcl_take_response()(client, id, response));
}

EXPORT int rcl_take_response_with_info(const void *client, struct request_info *info, void *response)
{
  unsigned me = begin_response(client);
  return response_result(me, real_rcl_take_response_with_info()(client, info, response));
}
