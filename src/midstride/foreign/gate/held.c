/* Requests that this node holds, since another one answers, or is to. */
#include "serving.h"

#include <stdlib.h>
#include <string.h>

/* For how long a request is held that no node has claimed (ns), and how many of a service are held. */
#define HOLD INT64_C(5000000000)
#define MOST_HELD 1000u
/* After how long the node that answered before answers a request that its successor has not received (ns). */
#define LEFT_OVER INT64_C(300000000)

/* No longer hold the request at `place`, which is returned. With `lock`. */
static struct held *unlink_held(struct entry *entry, struct held **place)
{
  struct held *held = *place;
  *place = held->next;
  if (entry->end == &held->next)
    entry->end = place;
  atomic_fetch_sub(&entry->holding, 1);
  return held;
}

void free_held(struct held *held)
{
  free(held->bytes.buffer);
  free(held->taken);
  free(held);
}

/* With `lock`; returns how many were held before. */
static uint32_t append(struct entry *entry, struct held *held)
{
  *entry->end = held;
  entry->end = &held->next;
  return atomic_fetch_add(&entry->holding, 1);
}

void hold_claimed(struct entry *entry, struct held *held)
{
  held->claimed = true;
  append(entry, held);
}

void drop_requests(struct entry *entry)
{
  if (entry->service == SEND_GOAL)
    drop_beyond(entry->me, (uint32_t)(entry->port - page->ports) + 1);
  while (entry->held)
    free_held(unlink_held(entry, &entry->held));
  while (entry->taken) {
    struct taken *next = entry->taken->next;
    free(entry->taken);
    entry->taken = next;
  }
}

void hold_request(struct entry *entry, const struct request_info *info, const void *request,
                  const struct subject *subject, bool added)
{
  struct held *held = calloc(1, sizeof *held), *surplus = NULL;
  if (!held)
    return;
  held->info = *info;
  held->subject = *subject;
  held->added = added;
  held->at = now_ns();
  held->came = arrival(info);
  held->bytes.memory = heap;
  if (real_rmw_serialize()(request, entry->type, &held->bytes) != 0) {
    real_rcutils_reset_error()();
    free_held(held);
    return;
  }
  struct requests *requests = requests_of(entry->me);
  if (requests && is_mixed(requests))
    note_known(requests, identity_of(info->sent, info->id.number));
  pthread_mutex_lock(&lock);
  if (append(entry, held) == MOST_HELD)
    surplus = unlink_held(entry, &entry->held);
  pthread_mutex_unlock(&lock);
  if (surplus)
    free_held(surplus);
}

enum turn turn_with_held(struct requests *requests, const struct entry *entry, const struct held *held)
{
  bool own = answers(requests, entry);
  return turn_with(requests, entry, &held->subject, &held->info.id, held->at, held->added, own);
}

/* A copy of a request, to add to the answer of another node; it stays held, in case this one is to answer in the end. NULL
 * where there is no memory. With `lock`. */
static struct held *copied_to_add(struct held *held)
{
  struct held *copy = calloc(1, sizeof *copy);
  if (!copy)
    return NULL;
  *copy = *held;
  copy->next = NULL;
  copy->bytes.buffer = malloc(held->bytes.length);
  copy->taken = calloc(1, sizeof *copy->taken);
  if (!copy->bytes.buffer || !copy->taken) {
    free_held(copy);
    return NULL;
  }
  memcpy(copy->bytes.buffer, held->bytes.buffer, held->bytes.length);
  copy->bytes.capacity = held->bytes.length;
  *copy->taken = (struct taken){.id = held->info.id, .subject = held->subject, .adds = true};
  held->added = true;
  held->announced = false;
  return copy;
}

/* The first of the requests that are held which is this node's to take; NULL where there is none. */
static struct held *due(struct entry *entry, struct requests *requests)
{
  if (!atomic_load(&entry->holding))
    return NULL;
  struct held *found = NULL, *claimed_elsewhere = NULL;
  pthread_mutex_lock(&lock);
  for (struct held **place = &entry->held; *place && !found;) {
    struct held *held = *place;
    bool lost = !held->claimed && is_lost(requests, held->came);
    enum turn turn = held->claimed || lost ? ANSWER : turn_with_held(requests, entry, held);
    if (held->claimed) {
      found = unlink_held(entry, place);
    } else if (turn != ANSWER) {
      if (turn == ADD && claim_request(requests, &held->info, true))
        found = copied_to_add(held);
      place = &held->next;
    } else if (!lost && begin_request(requests, entry, &held->info, &held->subject, now_ns(), &held->taken)) {
      found = unlink_held(entry, place);
    } else {
      held = unlink_held(entry, place);
      held->next = claimed_elsewhere;
      claimed_elsewhere = held;
    }
  }
  pthread_mutex_unlock(&lock);
  while (claimed_elsewhere) {
    struct held *next = claimed_elsewhere->next;
    free_held(claimed_elsewhere);
    claimed_elsewhere = next;
  }
  return found;
}

bool take_held(struct entry *entry, struct requests *requests, struct request_info *info, void *request)
{
  struct held *held;
  while ((held = due(entry, requests))) {
    bool read = real_rmw_deserialize()(&held->bytes, entry->type, request) == 0;
    bool own = !held->taken || !(held->taken->adds || held->taken->own);
    *info = held->info;
    if (read) {
      remember(entry, held->taken);
      held->taken = NULL;
    }
    free_held(held);
    if (read) {
      if (own && !is_asked(&info->id))
        note_setting(entry, request);
      return true;
    }
    real_rcutils_reset_error()();
    if (own && !is_asked(&info->id))
      answered(entry, requests, &info->id, false);
  }
  return false;
}

bool is_due(struct entry *entry)
{
  bool holds = entry && entry->kind == SERVER && atomic_load(&entry->holding) && !has_to_leave(entry->me);
  struct requests *requests = holds ? requests_of(entry->me) : NULL;
  for (struct held *held = requests ? entry->held : NULL; held; held = held->next)
    if (held->claimed || turn_with_held(requests, entry, held) != WAIT)
      return true;
  return false;
}

/* Whether a request is held no longer that no node has claimed. It stays if this node is to answer it: now, or, as another one
 * has the goal that it is about and has not received it, once that one has ended. */
static bool is_over(struct requests *requests, const struct entry *entry, const struct held *held)
{
  if (now_ns() - held->at <= HOLD || turn_with_held(requests, entry, held) == ANSWER)
    return false;
  return held->subject.about != ABOUT_ONE || BEFORE(atomic_load(&requests->word)) == entry->me ||
         turn_with(requests, entry, &held->subject, &held->info.id, held->at, held->added, true) == ANSWER;
}

/* What is held of a server: forget what another node has claimed; claim what its successor has not received. With `lock`. */
static uint32_t look_at_held(struct entry *entry, struct requests *requests)
{
  int64_t now = now_ns();
  uint32_t waiting = 0;
  uint64_t word = atomic_load(&requests->word);
  for (struct held **place = &entry->held; *place;) {
    struct held *held = *place;
    if (!held->claimed &&
        (is_lost(requests, held->came) || is_over(requests, entry, held) || !claim_request(requests, &held->info, true))) {
      free_held(unlink_held(entry, place));
      continue;
    }
    if (!held->claimed && BEFORE(word) == entry->me && now - held->at > LEFT_OVER) {
      uint64_t seen = atomic_load(&client_of(requests, client_key(&held->info.id))->seen);
      bool received = seen >> 48 == ANSWERING(word) && seen <= SEEN(ANSWERING(word), held->info.id.number);
      received |= is_known(requests, identity_of(held->info.sent, held->info.id.number) | ARRIVED, NOWHERE);
      /* As if this node answered: what is about a goal of its successor is still that one's. */
      bool own = turn_with(requests, entry, &held->subject, &held->info.id, held->at, held->added, true) == ANSWER;
      if (!received && own && begin_request(requests, entry, &held->info, &held->subject, now, &held->taken))
        held->claimed = true;
    }
    waiting += !held->claimed;
    place = &held->next;
  }
  return waiting;
}

void look_at_server(struct entry *entry)
{
  struct requests *requests = requests_of(entry->me);
  if (!requests)
    return;
  if (entry->service == CANCEL_GOAL && !entry->cancelled && atomic_load(&page->nodes[entry->me - 1].cancels))
    cancel_all(entry);
  if (atomic_load(&requests->shared))
    used_ports[entry->used].matched += (uint32_t)clients_of(entry->owner, entry->port->topic);
  uint32_t waiting = atomic_load(&entry->holding) ? look_at_held(entry, requests) : 0;
  used_ports[entry->used].waiting += waiting;
  atomic_store(&entry->port->waiting, oldest_of(entry));
  if (is_due(entry))
    announce(entry);
}
