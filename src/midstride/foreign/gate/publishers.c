/* Publishers: what is published, and what is kept of a publisher whose gate is closed. */
#include "gate.h"

#include <stdlib.h>
#include <string.h>

#define MOST_KEPT 1000u
/* How many answers to messages are kept that another node has not given yet, and their bytes; where none has given any,
 * fewer. */
#define MOST_ANSWERS 10000u
#define MOST_BYTES ((size_t)64 << 20)
#define FEWER_ANSWERS 100u
#define FEWER_BYTES ((size_t)16 << 20)

/* What the node has given to be published: one of `message` and `bytes`. */
struct given {
  const void *message;
  const serialized *bytes;
  struct input input; /* that it answers */
};

/* PUBLISH: now, and no other node does until `leave`. HOLD_IT: not now. LEAVE_IT: another node has answered the input. */
enum admission { PUBLISH, HOLD_IT, LEAVE_IT };

/* A failure that the node has no part in is no error of its next call. */
static void reset_error(void)
{
  if (real_rcutils_reset_error())
    real_rcutils_reset_error()();
}

bool is_latched(const struct qos *qos)
{
  return qos && qos->durability == TRANSIENT_LOCAL;
}

unsigned most_kept(const struct qos *qos)
{
  if (!is_latched(qos) || (qos->history == KEEP_LAST && qos->depth <= 1))
    return 1;
  return qos->history == KEEP_LAST && qos->depth < MOST_KEPT ? (unsigned)qos->depth : MOST_KEPT;
}

static void discard_oldest(struct entry *entry)
{
  struct kept *oldest = entry->kept;
  entry->kept = oldest->next;
  entry->kept_bytes -= oldest->bytes.length;
  free(oldest->bytes.buffer);
  free(oldest);
  entry->keeping--;
  if (!entry->kept)
    entry->kept_end = &entry->kept;
}

void discard_kept(struct entry *entry, unsigned remaining)
{
  while (entry->keeping > remaining)
    discard_oldest(entry);
  if (!entry->keeping)
    atomic_store(&entry->port->kept, 0);
}

/* Of what is kept: the last messages, as many as a subscriber gets, and before them answers that no node has given. With
 * `lock`. */
static void discard_answered(struct entry *entry)
{
  unsigned flags = atomic_load_explicit(&entry->port->flags, memory_order_relaxed);
  bool decide = answers_decide(flags);
  while (entry->keeping > entry->most_kept) {
    const struct input *input = &entry->kept->input;
    bool beside = decide || another_answers(entry, input);
    bool fits = entry->keeping <= (beside ? MOST_ANSWERS : FEWER_ANSWERS) &&
                entry->kept_bytes <= (beside ? MOST_BYTES : FEWER_BYTES);
    if (flags & ANSWERS && input->number && fits && !is_answered(entry, input))
      break;
    discard_oldest(entry);
  }
}

/* Keep a message that the gate has held back, as bytes: what it refers to is the node's. */
static void keep(struct entry *entry, const struct given *given)
{
  const serialized *bytes = given->bytes;
  struct kept *kept = calloc(1, sizeof *kept);
  if (!kept)
    return;
  kept->bytes.memory = heap;
  kept->input = given->input;
  bool copied;
  if (bytes) {
    kept->bytes.buffer = malloc(bytes->length ? bytes->length : 1);
    copied = kept->bytes.buffer != NULL;
    if (copied)
      memcpy(kept->bytes.buffer, bytes->buffer, bytes->length);
    kept->bytes.length = kept->bytes.capacity = bytes->length;
  } else {
    copied = real_rmw_serialize() && entry->type && real_rmw_serialize()(given->message, entry->type, &kept->bytes) == 0;
  }
  if (!copied) {
    reset_error();
    free(kept->bytes.buffer);
    free(kept);
    return;
  }
  pthread_mutex_lock(&lock);
  *entry->kept_end = kept;
  entry->kept_end = &kept->next;
  entry->keeping++;
  entry->kept_bytes += kept->bytes.length;
  discard_answered(entry);
  atomic_store(&entry->port->kept, 1);
  pthread_mutex_unlock(&lock);
}

/* Publish what is kept, in its order, in a call that may. `decide`: but for what another node has answered. With `lock`. */
static void publish_all(struct entry *entry, bool decide)
{
  const void *publisher = atomic_load(&entry->endpoint);
  for (struct kept *kept = entry->kept; kept; kept = kept->next) {
    if (decide && is_answered(entry, &kept->input))
      continue;
    note_answer(entry, &kept->input);
    if (real_rcl_publish_serialized_message()(publisher, &kept->bytes, NULL) == 0) {
      count_call(entry->port, true);
      count_written(entry->port);
    } else {
      reset_error();
    }
  }
  discard_kept(entry, 0);
}

void publish_kept(struct entry *entry)
{
  struct pass pass;
  unsigned flags = atomic_load_explicit(&entry->port->flags, memory_order_relaxed);
  bool decide = answers_decide(flags);
  if (!(flags & (KEEPS | ANSWERS)))
    discard_kept(entry, 0);
  while (decide && entry->kept && is_answered(entry, &entry->kept->input))
    discard_kept(entry, entry->keeping - 1); /* so that this node does not become the writer without a message */
  if (!decide && entry->kept)
    is_answered(entry, &entry->kept->input); /* noted also where no other input follows */
  if (!entry->kept || !enter(page, entry->me, descriptor, entry->port, &entry->overdue, &pass))
    return;
  if (!decide)
    discard_kept(entry, flags & KEEPS ? entry->most_kept : 0);
  publish_all(entry, decide);
  leave(&pass);
}

/* Mark the node by the identity of the first publisher of its process, by which the graph shows what belongs to it. */
static void mark(const void *publisher)
{
  if (atomic_load(&node->marked) || !real_rcl_publisher_get_rmw_handle() || !real_rmw_get_gid_for_publisher())
    return;
  struct identity identity;
  if (!graph_identity(publisher, &identity))
    return;
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
  if (page && result == 0) {
    mark(publisher);
    note_created(publisher);
  }
  return result;
}

EXPORT int rcl_publisher_fini(void *publisher, void *owner)
{
  remove_entry(publisher);
  return real_rcl_publisher_fini()(publisher, owner);
}

static void publish_kept_now(struct entry *entry)
{
  pthread_mutex_lock(&lock);
  publish_kept(entry);
  pthread_mutex_unlock(&lock);
}

/* Whether a message may be published. One that is kept comes first. */
static enum admission admit(struct entry *entry, const struct input *input, struct pass *pass)
{
  bool decide = answers_decide(atomic_load_explicit(&entry->port->flags, memory_order_relaxed));
  if (!decide && atomic_load_explicit(&entry->port->kept, memory_order_relaxed))
    publish_kept_now(entry);
  if (decide && is_answered(entry, input))
    return LEAVE_IT;
  if (!enter(page, entry->me, descriptor, entry->port, &entry->overdue, pass))
    return HOLD_IT;
  if (decide) {
    /* Before a later answer of this node is noted, after which an earlier one of the other node is not known any more. */
    if (atomic_load(&entry->port->kept)) {
      pthread_mutex_lock(&lock);
      publish_all(entry, true);
      pthread_mutex_unlock(&lock);
    }
    if (is_answered(entry, input)) { /* meanwhile */
      leave(pass);
      return LEAVE_IT;
    }
  }
  note_answer(entry, input);
  return PUBLISH;
}

/* Whether the node may publish what it has given; else it is kept, where it may be needed. */
static bool admitted(struct entry *entry, const void *message, const serialized *bytes, struct pass *pass)
{
  struct given given = {message, bytes, answered_by(entry)};
  enum admission admission = admit(entry, &given.input, pass);
  if (admission == PUBLISH)
    return true;
  count_call(entry->port, false);
  unsigned flags = atomic_load_explicit(&entry->port->flags, memory_order_relaxed);
  if (admission == HOLD_IT && (flags & KEEPS || (flags & ANSWERS && given.input.number))) {
    keep(entry, &given);
    if (answers_decide(flags)) /* it may have become this node's to answer meanwhile */
      publish_kept_now(entry);
  }
  return false;
}

static int published(struct entry *entry, struct pass *pass, bool counted, int result)
{
  if (result == 0) {
    count_call(entry->port, true);
    if (!counted)
      count_written(entry->port);
  }
  leave(pass);
  return result;
}

EXPORT int rcl_publish(const void *publisher, const void *message, void *allocation)
{
  struct entry *entry = find_entry(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish()(publisher, message, allocation);
  bool counted = has_counted(publisher);
  if (!admitted(entry, message, NULL, &pass))
    return 0;
  return published(entry, &pass, counted, real_rcl_publish()(publisher, message, allocation));
}

EXPORT int rcl_publish_serialized_message(const void *publisher, const void *message, void *allocation)
{
  struct entry *entry = find_entry(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish_serialized_message()(publisher, message, allocation);
  if (!admitted(entry, NULL, message, &pass))
    return 0;
  return published(entry, &pass, false, real_rcl_publish_serialized_message()(publisher, message, allocation));
}

EXPORT int rcl_publish_loaned_message(const void *publisher, void *message, void *allocation)
{
  struct entry *entry = find_entry(publisher);
  struct pass pass;
  if (!entry)
    return real_rcl_publish_loaned_message()(publisher, message, allocation);
  if (!admitted(entry, message, NULL, &pass))
    return real_rcl_return_loaned_message_from_publisher()(publisher, message);
  return published(entry, &pass, false, real_rcl_publish_loaned_message()(publisher, message, allocation));
}
