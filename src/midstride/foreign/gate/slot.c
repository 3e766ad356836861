/* For a component with Midstride's API that hands over to such a node, or takes over from it.
 *
 * It joins a shared slot: the part of a node in the page, for the length of a hand-over. One thread publishes (begin, end).
 * In another one it shares the requests to its services; its calls for these are made one at a time.
 */
#include "serving.h"

#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

struct slot {
  struct page *page;
  int file;
  unsigned index;
  struct pass pass;
  unsigned count;
  struct {
    struct port *port;
    bool overdue;
  } outputs[];
};

EXPORT struct slot *midstride_join(const char *path, unsigned index)
{
  static struct page *shared;
  static int file = -1;
  static dev_t device;
  static ino_t inode;
  struct stat status;
  if (index >= NODES || stat(path, &status) != 0)
    return NULL;
  /* One open file for all slots: to close another one of the same page would release every lock of this process. */
  if (!shared || status.st_ino != inode || status.st_dev != device) {
    uint32_t version;
    int opened = open(path, O_RDWR | O_CLOEXEC);
    struct page *found = opened < 0 ? NULL : map_page(opened, &version);
    if (!found) {
      if (opened >= 0)
        close(opened);
      return NULL;
    }
    shared = found;
    file = opened;
    device = status.st_dev;
    inode = status.st_ino;
  }
  unsigned count = 0, room = atomic_load(&shared->head.room);
  for (unsigned port = 0; port < room; port++)
    count += atomic_load(&shared->ports[port].node) == index + 1;
  struct slot *slot = calloc(1, sizeof *slot + count * sizeof slot->outputs[0]);
  struct flock own = lock_of(index + 1, F_WRLCK);
  if (!slot || fcntl(file, F_SETLK, &own) != 0) {
    free(slot);
    return NULL;
  }
  slot->page = shared;
  slot->file = file;
  slot->index = index;
  slot->count = count;
  for (unsigned port = 0; port < room; port++)
    if (atomic_load(&shared->ports[port].node) == index + 1 && shared->ports[port].number < count)
      slot->outputs[shared->ports[port].number].port = &shared->ports[port];
  atomic_store(&shared->nodes[index].pid, (uint32_t)getpid());
  return slot;
}

/* The hand-over is over: its part in the page is free. */
EXPORT void midstride_leave_slot(struct slot *slot)
{
  struct flock own = lock_of(slot->index + 1, F_UNLCK);
  midstride_free(slot->page, slot->index);
  fcntl(slot->file, F_SETLK, &own);
  free(slot);
}

EXPORT int midstride_begin(struct slot *slot, unsigned port)
{
  return port < slot->count && slot->outputs[port].port &&
         enter(slot->page, slot->index + 1, slot->file, slot->outputs[port].port, &slot->outputs[port].overdue,
               &slot->pass);
}

EXPORT void midstride_end(struct slot *slot)
{
  leave(&slot->pass);
}

EXPORT struct baton *midstride_baton(struct slot *slot, unsigned number)
{
  return &slot->page->batons[number - 1];
}

/* -- requests to its services ---------------------------------------------------------------------------------------- */

static struct requests *shared_requests(const struct slot *slot)
{
  uint32_t number = atomic_load(&slot->page->nodes[slot->index].requests);
  return number && number <= NODES ? requests_at(slot->page, number - 1) : NULL;
}

/* Whether it has a service, which the other node may have, too. */
EXPORT int midstride_serve(struct slot *slot, const char *name)
{
  struct port *port = strlen(name) < NAME ? reserve_port(slot->page, slot->file, slot->index + 1) : NULL;
  if (!port)
    return 0;
  strncpy(port->topic, name, NAME - 1);
  atomic_store(&port->endpoints, 1);
  atomic_store(&port->kind, SERVER);
  return 1;
}

/* Whether it answers what arrives now. It does, too, where the manager has taken its part back. */
EXPORT int midstride_answers(struct slot *slot)
{
  struct requests *requests = shared_requests(slot);
  return !requests || !answers_before(slot->page, slot->file, requests, slot->index + 1);
}

/* Whether it has answered before the node that does now. */
EXPORT int midstride_answered_before(struct slot *slot)
{
  struct requests *requests = shared_requests(slot);
  return requests && BEFORE(atomic_load(&requests->word)) == slot->index + 1;
}

/* Claim a request that its client has sent at `sent` (Unix time, ns); whether no other node has. */
EXPORT int midstride_claim_request(struct slot *slot, int64_t sent, int64_t number)
{
  struct requests *requests = shared_requests(slot);
  uint64_t claimed = identity_of(sent, number) | CLAIMED;
  if (!requests)
    return 1;
  const struct requests *first = requests_at(slot->page, 0);
  lock_part(slot->file, requests, first, OF_KNOWN, F_WRLCK);
  bool is_first = !is_known(requests, claimed, NOWHERE);
  if (is_first) {
    note_known(requests, claimed);
    atomic_fetch_add(&slot->page->nodes[slot->index].unanswered, 1);
  }
  lock_part(slot->file, requests, first, OF_KNOWN, F_UNLCK);
  return is_first;
}

/* It has claimed a request before it shared them. */
EXPORT void midstride_note_claimed(struct slot *slot, int64_t sent, int64_t number)
{
  struct requests *requests = shared_requests(slot);
  if (requests)
    note_known(requests, identity_of(sent, number) | CLAIMED);
}

/* It has noted all that it has claimed before; which services it has, it has said. */
EXPORT void midstride_has_noted(struct slot *slot)
{
  atomic_fetch_or(&slot->page->nodes[slot->index].used, NOTED);
}

/* It holds a request. */
EXPORT void midstride_note_arrived(struct slot *slot, int64_t sent, int64_t number)
{
  struct requests *requests = shared_requests(slot);
  if (requests)
    note_known(requests, identity_of(sent, number) | ARRIVED);
}

/* What is known of a request: a node has claimed it (1), the other one holds it (2), or neither (0). */
EXPORT int midstride_known(struct slot *slot, int64_t sent, int64_t number)
{
  struct requests *requests = shared_requests(slot);
  uint64_t request = identity_of(sent, number);
  if (!requests)
    return 0;
  return is_known(requests, request | CLAIMED, NOWHERE) ? 1 : is_known(requests, request, NOWHERE) ? 2 : 0;
}

/* It has answered a request that it had claimed. */
EXPORT void midstride_answered(struct slot *slot)
{
  atomic_store(&slot->page->nodes[slot->index].answered, now_ns());
  count_answered(slot->page, shared_requests(slot), slot->index + 1);
}

/* It is to answer from now on; the other node has until `until` (CLOCK_MONOTONIC, ns) for what it has taken. */
EXPORT void midstride_answer(struct slot *slot, int64_t until)
{
  uint32_t number = atomic_load(&slot->page->nodes[slot->index].requests);
  if (!number || number > NODES)
    return;
  uint64_t word = midstride_requests_step(slot->page, slot->file, number - 1, GIVE_REQUESTS, slot->index + 1, until);
  if (BEFORE(word))
    midstride_ring(slot->page, BEFORE(word) - 1);
}

/* How many requests the node has not answered that answered before it. */
EXPORT unsigned midstride_left_before(struct slot *slot)
{
  struct requests *requests = shared_requests(slot);
  unsigned before = requests ? BEFORE(atomic_load(&requests->word)) : 0;
  return before ? atomic_load(&slot->page->nodes[before - 1].unanswered) : 0;
}

/* Whether no other node that lives shares the requests. */
EXPORT int midstride_is_alone(struct slot *slot)
{
  uint32_t number = atomic_load(&slot->page->nodes[slot->index].requests);
  for (unsigned index = 0; number && index < NODES; index++) {
    struct node *other = &slot->page->nodes[index];
    if (index != slot->index && atomic_load(&other->used) && atomic_load(&other->requests) == number &&
        !(atomic_load(&other->pid) && is_dead(slot->file, index + 1)))
      return 0;
  }
  return 1;
}
