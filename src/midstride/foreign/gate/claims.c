/* Which node answers a request, and that each request is answered by one: the steps of requests.h, in the page. */
#include "serving.h"

#include <string.h>
#include <time.h>
#include <unistd.h>

static pthread_mutex_t client_lock = PTHREAD_MUTEX_INITIALIZER;

bool is_asked(const struct request_id *id)
{
  return memcmp(id->client, MANAGER, sizeof MANAGER) == 0;
}

struct requests *requests_of(unsigned me)
{
  uint32_t number = atomic_load_explicit(&page->nodes[me - 1].requests, memory_order_acquire);
  return number && number <= NODES ? requests_at(page, number - 1) : NULL;
}

static bool ended(struct page *shared, int file, unsigned index)
{
  uint32_t pid = atomic_load(&shared->nodes[index - 1].pid);
  return pid && pid != (uint32_t)getpid() && is_dead(file, index);
}

bool has_ended(unsigned index)
{
  return ended(page, descriptor, index);
}

/* Whether the node `other` (index + 1) has the service of `entry`, too. */
static bool has_service(unsigned other, const struct entry *entry)
{
  const struct node *component = &page->nodes[other - 1];
  if ((atomic_load(&component->used) & (HAS_AGENT | NOTED)) == HAS_AGENT) /* it has not said which it has */
    return entry->service == OTHER;
  for (unsigned index = 0; index < atomic_load(&page->head.room); index++) {
    struct port *port = &page->ports[index];
    if (atomic_load(&port->node) == other && atomic_load(&port->kind) == SERVER && atomic_load(&port->endpoints) &&
        strncmp(port->topic, entry->port->topic, NAME) == 0)
      return true;
  }
  return false;
}

unsigned answers_before(struct page *shared, int file, struct requests *requests, unsigned me)
{
  uint64_t word = atomic_load(&requests->word), next;
  do {
    unsigned before = BEFORE(word);
    if (ANSWERING(word) == me) {
      if (word & BEGUN)
        return 0;
      if (before && atomic_load(&shared->nodes[before - 1].unanswered) && now_ns() < atomic_load(&requests->until) &&
          !ended(shared, file, before))
        return before;
      next = word | BEGUN;
    } else if (before == me && ended(shared, file, ANSWERING(word))) {
      next = requests_take_back(word, me);
    } else {
      return ANSWERING(word);
    }
  } while (!atomic_compare_exchange_weak(&requests->word, &word, next));
  return 0;
}

bool answers(struct requests *requests, const struct entry *entry)
{
  int64_t paused = atomic_load(&requests->paused);
  if (paused && now_ns() < paused)
    return false;
  unsigned other = answers_before(page, descriptor, requests, entry->me);
  return !other || !has_service(other, entry);
}

void count_answered(struct page *shared, struct requests *requests, unsigned me)
{
  _Atomic uint32_t *unanswered = &shared->nodes[me - 1].unanswered;
  uint32_t left = atomic_load(unanswered);
  while (left && !atomic_compare_exchange_weak(unanswered, &left, left - 1))
    ;
  uint64_t word = requests ? atomic_load(&requests->word) : 0;
  if (left == 1 && BEFORE(word) == me && ANSWERING(word) && !(word & BEGUN))
    midstride_ring(shared, ANSWERING(word) - 1);
}

uint64_t client_key(const struct request_id *id)
{
  return key_of(id->client, client_length(id));
}

void lock_places(struct requests *requests, enum places places, short type)
{
  lock_part(descriptor, requests, requests_at(page, 0), places, type);
}

static struct client *find_client(struct requests *requests, uint64_t key)
{
  for (unsigned step = 0; step < CLIENTS; step++) {
    struct client *client = &requests->clients[(key + step) % CLIENTS];
    uint64_t known = atomic_load_explicit(&client->id, memory_order_acquire);
    if (known == key)
      return client;
    if (!known)
      return NULL;
  }
  return NULL;
}

struct client *client_of(struct requests *requests, uint64_t key)
{
  struct client *found = find_client(requests, key);
  if (found)
    return found;
  pthread_mutex_lock(&client_lock);
  lock_places(requests, OF_CLIENTS, F_WRLCK);
  found = find_client(requests, key);
  if (!found) {
    struct client *oldest = NULL;
    for (unsigned step = 0; step < CLIENTS; step++) {
      struct client *client = &requests->clients[(key + step) % CLIENTS];
      if (!atomic_load(&client->id)) {
        oldest = client;
        break;
      }
      if (!oldest || atomic_load(&client->last) < atomic_load(&oldest->last))
        oldest = client;
    }
    found = oldest;
    atomic_store(&found->word, key >> 48 << 48); /* its tag: a step for the client before fails */
    atomic_store(&found->seen, 0);
    atomic_store(&found->last, now_ns());
    atomic_store_explicit(&found->id, key, memory_order_release);
  }
  lock_places(requests, OF_CLIENTS, F_UNLCK);
  pthread_mutex_unlock(&client_lock);
  return found;
}

/* Claim a request by its number at its client. */
static bool claim_number(struct requests *requests, const struct request_id *id, bool only_look)
{
  uint64_t key = client_key(id);
  for (;;) {
    struct client *client = client_of(requests, key);
    uint64_t word = atomic_load(&client->word), next;
    while (TAG(word) == key >> 48) {
      if (!requests_claim(word, (uint32_t)id->number, &next))
        return false;
      if (only_look)
        return true;
      if (atomic_compare_exchange_weak(&client->word, &word, next)) {
        atomic_store_explicit(&client->last, now_ns(), memory_order_relaxed);
        return true;
      }
    }
  }
}

bool claim_request(struct requests *requests, const struct request_info *info, bool only_look)
{
  uint64_t claimed = identity_of(info->sent, info->id.number) | CLAIMED;
  /* First: so of two nodes with the library one notes it, and neither takes the note of the other for that of a component. */
  if (!claim_number(requests, &info->id, only_look))
    return false;
  uint32_t own = only_look ? NOWHERE : note_known(requests, claimed);
  if (!is_mixed(requests))
    return true;
  if (!only_look) { /* a component may be between its look and its note */
    pthread_mutex_lock(&client_lock);
    lock_places(requests, OF_KNOWN, F_WRLCK);
    lock_places(requests, OF_KNOWN, F_UNLCK);
    pthread_mutex_unlock(&client_lock);
  }
  return !is_known(requests, claimed, own);
}

void note_seen(struct requests *requests, unsigned me, const struct request_id *id)
{
  uint64_t word = atomic_load(&requests->word);
  if (BEFORE(word) == me || (ANSWERING(word) == me && !BEFORE(word)))
    return;
  struct client *client = client_of(requests, client_key(id));
  atomic_store_explicit(&client->last, now_ns(), memory_order_relaxed);
  if (atomic_load(&client->seen) >> 48 != me)
    atomic_store(&client->seen, SEEN(me, id->number));
}

/* A clock that is set by more than this between the arrival of a request and its being taken is noticed (ns). */
#define LONGEST_WAIT INT64_C(60000000000)

/* The middleware says when it received it by CLOCK_REALTIME; it may not say so (0), or that clock may have been set. */
int64_t arrival(const struct request_info *info)
{
  int64_t now = now_ns();
  if (info->received <= 0)
    return now;
  struct timespec at;
  clock_gettime(CLOCK_REALTIME, &at);
  int64_t waited = at.tv_sec * INT64_C(1000000000) + at.tv_nsec - info->received;
  return waited > 0 && waited < LONGEST_WAIT ? now - waited : now;
}

bool is_lost(struct requests *requests, int64_t came)
{
  return came < atomic_load(&requests->lost);
}
