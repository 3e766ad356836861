/* Intra-process communication of rclcpp: what subscriptions of the same process get this way does not go through
 * rcl_publish, and so goes past the gate.
 *
 * A publisher of rclcpp registers with the manager of that communication, and then has `setup_intra_process` called, from
 * which on it takes part. Where the page says so, that is left out, and the registration is undone: else these
 * subscriptions would drop what reaches them through the middleware. librclcpp exports both functions, and has not changed
 * them from Humble to Kilted.
 */
#include "gate.h"

/* The publisher of rcl that this thread has created last: that of rclcpp is set up right after that. */
static _Thread_local const void *created;

void note_created(const void *publisher)
{
  created = publisher;
}

static struct entry *entry_of(const void *publisher)
{
  struct entry *entry = created ? find_entry(created) : NULL;
  if (!entry || !real_publisher_get_topic_name())
    return NULL;
  return real_publisher_get_topic_name()(publisher) == real_rcl_publisher_get_topic_name()(created) ? entry : NULL;
}

/* A shared_ptr is passed by its address, and begins with the pointer. */
EXPORT void setup_intra_process(void *publisher, uint64_t number, void **manager) __asm__(SETUP_INTRA_PROCESS);
void setup_intra_process(void *publisher, uint64_t number, void **manager)
{
  struct entry *entry = entry_of(publisher);
  if (entry && atomic_load(&entry->port->within) & KEEP_OUT && real_remove_publisher()) {
    real_remove_publisher()(*manager, number);
    atomic_fetch_or(&entry->port->within, KEPT_OUT);
    return;
  }
  if (entry)
    atomic_fetch_or(&entry->port->within, TAKES_PART);
  if (real_setup_intra_process())
    real_setup_intra_process()(publisher, number, manager);
}
