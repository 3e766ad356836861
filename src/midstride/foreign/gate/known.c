/* Which of the last requests to a role's services are claimed, one by one: between the library in a node and a component with
 * Midstride's API, which knows of a request when its client has sent it and its number, but not whose it is.
 *
 * The library notes each request that it claims at once, without a lock, and looks among the others only while a component
 * shares the role. That one looks and notes in one step, under the lock. So of two that claim a request at once, either the
 * component finds the note of the library, or the library, which waits for the lock, that of the component.
 */
#include "known.h"

#include <sched.h>

bool is_mixed(struct requests *requests)
{
  int64_t until = atomic_load(&requests->mixed);
  return until && now_ns() < until;
}

void lock_part(int file, const struct requests *requests, const struct requests *first, enum places places, short type)
{
  struct flock whole = {.l_type = type, .l_whence = SEEK_SET, .l_len = 1};
  whole.l_start = NODES * places + (requests - first);
  int64_t deadline = now_ns() + LOOK;
  while (fcntl(file, F_SETLK, &whole) != 0 && now_ns() < deadline)
    sched_yield();
}

uint32_t note_known(struct requests *requests, uint64_t entry)
{
  uint32_t place = atomic_fetch_add(&requests->knows, 1);
  atomic_store(&requests->known[place % KNOWN], entry);
  return place;
}

bool is_known(struct requests *requests, uint64_t entry, uint32_t but)
{
  uint32_t count = atomic_load(&requests->knows), number = count < KNOWN ? count : KNOWN;
  for (uint32_t place = count - number; place != count; place++)
    if (place != but && atomic_load_explicit(&requests->known[place % KNOWN], memory_order_relaxed) == entry)
      return true;
  return false;
}
