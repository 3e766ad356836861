/* Publishers: what is published, and what is kept of a publisher whose gate is closed. */
#include "gate.h"

#include <stdlib.h>
#include <string.h>

#define MOST_KEPT 1000u

unsigned most_kept(const void *publisher)
{
  const struct qos *qos = real_rcl_publisher_get_actual_qos() ? real_rcl_publisher_get_actual_qos()(publisher) : NULL;
  if (!qos || qos->durability != TRANSIENT_LOCAL || (qos->history == KEEP_LAST && qos->depth <= 1))
    return 1;
  return qos->history == KEEP_LAST && qos->depth < MOST_KEPT ? (unsigned)qos->depth : MOST_KEPT;
}

void discard_kept(struct entry *entry, unsigned remaining)
{
  while (entry->keeping > remaining) {
    struct kept *oldest = entry->kept;
    entry->kept = oldest->next;
    free(oldest->bytes.buffer);
    free(oldest);
    entry->keeping--;
  }
  if (!entry->kept)
    entry->kept_end = &entry->kept;
}

/* Keep a message that the gate has held back, as bytes: what it refers to is the node's. */
static void keep(struct entry *entry, const void *message, const serialized *bytes)
{
  struct kept *kept = calloc(1, sizeof *kept);
  if (!kept)
    return;
  kept->bytes.memory = heap;
  bool copied;
  if (bytes) {
    kept->bytes.buffer = malloc(bytes->length ? bytes->length : 1);
    copied = kept->bytes.buffer != NULL;
    if (copied)
      memcpy(kept->bytes.buffer, bytes->buffer, bytes->length);
    kept->bytes.length = kept->bytes.capacity = bytes->length;
  } else {
    copied = real_rmw_serialize() && entry->type && real_rmw_serialize()(message, entry->type, &kept->bytes) == 0;
  }
  if (!copied) {
    free(kept->bytes.buffer);
    free(kept);
    return;
  }
  pthread_mutex_lock(&lock);
  *entry->kept_end = kept;
  entry->kept_end = &kept->next;
  entry->keeping++;
  discard_kept(entry, entry->most_kept);
  atomic_store(&entry->port->kept, 1);
  pthread_mutex_unlock(&lock);
}

void publish_kept(struct entry *entry)
{
  struct pass pass;
  if (entry->kept && !(atomic_load_explicit(&entry->port->flags, memory_order_relaxed) & KEEPS)) {
    discard_kept(entry, 0);
    atomic_store(&entry->port->kept, 0);
  }
  if (!entry->kept || !enter(page, entry->me, descriptor, entry->port, &entry->overdue, &pass))
    return;
  const void *publisher = atomic_load(&entry->endpoint);
  for (struct kept *kept = entry->kept; kept; kept = kept->next)
    if (real_rcl_publish_serialized_message()(publisher, &kept->bytes, NULL) == 0)
      count_call(entry->port, true);
  leave(&pass);
  discard_kept(entry, 0);
  atomic_store(&entry->port->kept, 0);
}

/* Mark the node by the identity of the first publisher of its process, by which the graph shows what belongs to it. */
static void mark(const void *publisher)
{
  if (atomic_load(&node->marked) || !real_rcl_publisher_get_rmw_handle() || !real_rmw_get_gid_for_publisher())
    return;
  struct identity identity;
  if (real_rmw_get_gid_for_publisher()(real_rcl_publisher_get_rmw_handle()(publisher), &identity) != 0) {
    if (real_rcutils_reset_error())
      real_rcutils_reset_error()();
    return;
  }
  pthread_mutex_lock(&lock);
  if (!atomic_load(&node->marked)) {
    memcpy(node->mark, identity.data, MARK);
    atomic_store(&node->marked, 1);
  }
  pthread_mutex_unlock(&lock);
}

EXPORT int rcl_publisher_init(void *publisher, const void *owner, const void *type, const char *name, const void *options)
{
  int result = real_rcl_publisher_init()(publisher, owner, type, name, options);
  if (page && result == 0 &&
      !add_entry(publisher, owner, real_rcl_publisher_get_topic_name()(publisher), OUTPUT, type, NULL)) {
    real_rcl_publisher_fini()(publisher, (void *)owner);
    return BAD_ALLOC;
  }
  if (page && result == 0)
    mark(publisher);
  return result;
}

EXPORT int rcl_publisher_fini(void *publisher, void *owner)
{
  remove_entry(publisher);
  return real_rcl_publisher_fini()(publisher, owner);
}

/* Whether a message may be published. One that is kept comes first. */
static bool admitted(struct entry *entry, struct pass *pass)
{
  if (atomic_load_explicit(&entry->port->kept, memory_order_relaxed)) {
    pthread_mutex_lock(&lock);
    publish_kept(entry);
    pthread_mutex_unlock(&lock);
  }
  return enter(page, entry->me, descriptor, entry->port, &entry->overdue, pass);
}

static void held_back(struct entry *entry, const void *message, const serialized *bytes)
{
  count_call(entry->port, false);
  if (atomic_load_explicit(&entry->port->flags, memory_order_relaxed) & KEEPS)
    keep(entry, message, bytes);
}

static int published(struct entry *entry, struct pass *pass, int result)
{
  if (result == 0)
    count_call(entry->port, true);
  leave(pass);
  return result;
}

EXPORT int rcl_publish(const void *publisher, const void *message, void *allocation)
{
  struct entry *entry = find_entry(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish()(publisher, message, allocation);
  if (!admitted(entry, &pass)) {
    held_back(entry, message, NULL);
    return 0;
  }
  return published(entry, &pass, real_rcl_publish()(publisher, message, allocation));
}

EXPORT int rcl_publish_serialized_message(const void *publisher, const void *message, void *allocation)
{
  struct entry *entry = find_entry(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish_serialized_message()(publisher, message, allocation);
  if (!admitted(entry, &pass)) {
    held_back(entry, NULL, message);
    return 0;
  }
  return published(entry, &pass, real_rcl_publish_serialized_message()(publisher, message, allocation));
}

EXPORT int rcl_publish_loaned_message(const void *publisher, void *message, void *allocation)
{
  struct entry *entry = find_entry(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish_loaned_message()(publisher, message, allocation);
  if (!admitted(entry, &pass)) {
    held_back(entry, message, NULL);
    return real_rcl_return_loaned_message_from_publisher()(publisher, message);
  }
  return published(entry, &pass, real_rcl_publish_loaned_message()(publisher, message, allocation));
}
