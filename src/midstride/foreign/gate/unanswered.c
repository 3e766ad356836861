/* Requests that this node has taken and not answered yet. */
#include "serving.h"

#include <stdlib.h>
#include <string.h>

/* What distinguishes a request; not 0. */
static uint64_t request_key(const struct request_id *id)
{
  uint64_t key = client_key(id) + (uint64_t)id->number * UINT64_C(0x9e3779b97f4a7c15);
  return key ? key : 1;
}

int64_t oldest_of(const struct entry *entry)
{
  int64_t oldest = 0;
  for (unsigned place = 0; place < UNANSWERED; place++) {
    int64_t since = atomic_load_explicit(&entry->unanswered[place].since, memory_order_relaxed);
    if (since && (!oldest || since < oldest))
      oldest = since;
  }
  return oldest;
}

/* A server has a request. One beyond those that there is room for is not measured. What two threads may leave wrong of the
 * oldest one, the helper thread corrects when it looks next. */
static void note_taken(struct entry *entry, const struct request_id *id, int64_t since)
{
  uint64_t key = request_key(id);
  for (unsigned step = 0; step < UNANSWERED; step++) {
    struct unanswered *place = &entry->unanswered[(key + step) % UNANSWERED];
    uint64_t free = 0;
    if (!atomic_compare_exchange_strong(&place->key, &free, key))
      continue;
    atomic_store(&place->since, since);
    int64_t oldest = atomic_load(&entry->port->waiting);
    if (!oldest || since < oldest)
      atomic_store(&entry->port->waiting, since);
    return;
  }
}

/* It has answered the request, or has it no longer: `sent` says whether it has. */
static void note_answered(struct entry *entry, const struct request_id *id, bool sent)
{
  uint64_t key = request_key(id);
  for (unsigned step = 0; step < UNANSWERED; step++) {
    struct unanswered *place = &entry->unanswered[(key + step) % UNANSWERED];
    if (atomic_load(&place->key) != key)
      continue;
    int64_t took = (now_ns() - atomic_load(&place->since)) / 1000;
    atomic_store(&place->since, 0);
    atomic_store(&place->key, 0);
    atomic_store(&entry->port->waiting, oldest_of(entry));
    if (!sent)
      return;
    uint32_t number = atomic_fetch_add(&entry->responses, 1);
    atomic_store(&entry->port->took[number % LATEST], took < UINT32_MAX ? (uint32_t)took : UINT32_MAX);
    atomic_store(&entry->port->answered, number + 1);
    return;
  }
}

static void answering(struct entry *entry, const struct request_id *id, int64_t since)
{
  count_call(entry->port, true);
  if (entry->service == GET_RESULT) /* which is answered when the goal has ended */
    return;
  atomic_fetch_add(&page->nodes[entry->me - 1].unanswered, 1);
  note_taken(entry, id, since);
}

bool begin_request(struct requests *requests, struct entry *entry, const struct request_info *info,
                   const struct subject *subject, int64_t since, struct taken **taken)
{
  const struct request_id *id = &info->id;
  uint32_t port = (uint32_t)(entry->port - page->ports) + 1;
  struct goal *goal = entry->service == SEND_GOAL ? reserve_goal(requests, entry->me, port, subject->goal) : NULL;
  *taken = NULL;
  if (!claim_request(requests, info, false)) {
    if (goal)
      step_goal(goal, entry->me, REJECT);
    return false;
  }
  answering(entry, id, since);
  if (entry->service == OTHER)
    return true;
  if (goal)
    step_goal(goal, entry->me, CLAIM);
  *taken = calloc(1, sizeof **taken);
  if (*taken)
    **taken = (struct taken){.id = *id, .subject = *subject, .goal = goal};
  return true;
}

void remember(struct entry *entry, struct taken *taken)
{
  if (!taken)
    return;
  pthread_mutex_lock(&lock);
  taken->next = entry->taken;
  entry->taken = taken;
  pthread_mutex_unlock(&lock);
}

struct taken *recall(struct entry *entry, const struct request_id *id)
{
  struct taken *found = NULL;
  pthread_mutex_lock(&lock);
  for (struct taken **place = &entry->taken; *place && !found; place = found ? place : &(*place)->next)
    if ((*place)->id.number == id->number && memcmp((*place)->id.client, id->client, sizeof id->client) == 0) {
      found = *place;
      *place = found->next;
    }
  pthread_mutex_unlock(&lock);
  return found;
}

void answered(struct entry *entry, struct requests *requests, const struct request_id *id, bool sent)
{
  atomic_store(&page->nodes[entry->me - 1].answered, now_ns());
  if (entry->service == GET_RESULT)
    return;
  note_answered(entry, id, sent);
  count_answered(page, requests, entry->me);
}
