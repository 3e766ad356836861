/* Intra-process communication of rclcpp: what subscriptions of the same process get this way does not go through
 * rcl_publish, and so goes past the gate.
 *
 * A publisher of rclcpp registers with the manager of that communication, and then has `setup_intra_process` called, from
 * which on it takes part. Where the page says so, that is left out, and the registration is undone: else these
 * subscriptions would drop what reaches them through the middleware. librclcpp exports both functions, the same from Humble
 * to Kilted; in Lyrical the first one has another name, since a shared_ptr is passed by reference.
 *
 * A publisher that takes part calls a function of tracetools with each message before subscriptions of the process get it
 * (from Iron on). So what does not go through rcl_publish is counted, and without a subscription, for which the publisher
 * would serialize. If there are readers elsewhere, the same thread passes the message to rcl_publish right after that.
 */
#include "gate.h"

/* The publisher of rcl that this thread has created last: that of rclcpp is set up right after that. */
static _Thread_local const void *created;

/* The publisher whose message this thread has counted last, until it passes that to rcl_publish. */
static _Thread_local const void *counted;

void note_created(const void *publisher)
{
  created = publisher;
  counted = NULL; /* it may have been another one at this address */
}

bool has_counted(const void *publisher)
{
  bool found = counted == publisher;
  counted = NULL;
  return found;
}

EXPORT void ros_trace_rclcpp_intra_publish(const void *publisher, const void *message)
{
  struct entry *entry = find_entry(publisher);
  if (entry) {
    int64_t now = now_ns();
    atomic_store_explicit(&entry->port->tried, now, memory_order_relaxed);
    atomic_store_explicit(&entry->port->last, now, memory_order_relaxed);
    atomic_fetch_add_explicit(&entry->port->inside, 1, memory_order_relaxed);
    count_written(entry->port);
    counted = publisher;
  }
  if (real_ros_trace_rclcpp_intra_publish())
    real_ros_trace_rclcpp_intra_publish()(publisher, message);
}

static struct entry *entry_of(const void *publisher)
{
  struct entry *entry = created ? find_entry(created) : NULL;
  if (!entry || !real_publisher_get_topic_name())
    return NULL;
  return real_publisher_get_topic_name()(publisher) == real_rcl_publisher_get_topic_name()(created) ? entry : NULL;
}

/* A shared_ptr begins with the pointer. Where it is passed by value, its caller passes the address of a copy. */
static void set_up(void *publisher, uint64_t number, void **manager, void (*really)(void *, uint64_t, void **))
{
  struct entry *entry = entry_of(publisher);
  if (entry && atomic_load(&entry->port->within) & KEEP_OUT && real_remove_publisher()) {
    real_remove_publisher()(*manager, number);
    atomic_fetch_or(&entry->port->within, KEPT_OUT);
    return;
  }
  if (entry)
    atomic_fetch_or(&entry->port->within, TAKES_PART);
  if (really)
    really(publisher, number, manager);
}

EXPORT void setup_intra_process(void *publisher, uint64_t number, void **manager) __asm__(SETUP_INTRA_PROCESS);
void setup_intra_process(void *publisher, uint64_t number, void **manager)
{
  set_up(publisher, number, manager, real_setup_intra_process());
}

EXPORT void setup_by_reference(void *publisher, uint64_t number, void **manager) __asm__(SETUP_BY_REFERENCE);
void setup_by_reference(void *publisher, uint64_t number, void **manager)
{
  set_up(publisher, number, manager, real_setup_by_reference());
}
