/* Whether a message may be published: a port's gate, and its baton. */
#include "gate.h"

#include <sched.h>
#include <unistd.h>

bool enter(struct page *shared, unsigned own, int file, struct port *port, bool *overdue, struct pass *pass)
{
  pass->baton = NULL;
  if (atomic_load_explicit(&port->gate, memory_order_acquire) != OPEN)
    return false;
  unsigned index = atomic_load_explicit(&port->baton, memory_order_acquire);
  if (index == 0 || index > BATONS)
    return true;
  struct baton *baton = &shared->batons[index - 1];
  pass->flags = atomic_load_explicit(&port->flags, memory_order_relaxed);
  int dead = -1;
  uint64_t seen = atomic_load(&baton->word);
  for (;;) {
    uint64_t next;
    int64_t left = pass->flags & RATED ? atomic_load(&port->half) * INT64_C(1000) : atomic_load(&baton->patience);
    int waited = STATE(seen) == OFFERED && (*overdue || now_ns() - atomic_load(&baton->offered) > left);
    int collided = atomic_load(&baton->collisions) >= COLLISIONS;
    switch (baton_enter(seen, own, pass->flags, waited, collided, dead, &next)) {
    case PASS:
      if (!atomic_compare_exchange_weak(&baton->word, &seen, next)) {
        dead = -1;
        continue;
      }
      pass->baton = baton;
      pass->entered = next;
      pass->again = STATE(seen) == OFFERED && HOLDER(seen) == own && SUCCESSOR(next) != 0;
      *overdue = pass->again && pass->flags & TIMED;
      return true;
    case SKIP:
      if (pass->flags & RATED)
        atomic_store(&baton->collisions, 0);
      return false;
    case ASK:
      /* A process does not see its own locks: two slots may be of one. */
      dead = atomic_load(&shared->nodes[HOLDER(seen) - 1].pid) != (uint32_t)getpid() && is_dead(file, HOLDER(seen));
      continue;
    case BUSY:
      sched_yield();
      seen = atomic_load(&baton->word);
      continue;
    case HOLD_BACK:
      if (SUCCESSOR(seen) == own && STATE(seen) == HELD && WRITERS(seen) != 0)
        atomic_fetch_add(&baton->collisions, 1);
      *overdue = false;
      return false;
    }
  }
}

void leave(struct pass *pass)
{
  struct baton *baton = pass->baton;
  if (!baton)
    return;
  uint64_t seen = atomic_load(&baton->word), next;
  do {
    next = baton_leave(seen, pass->entered, pass->flags, pass->again);
    if (next == seen)
      return;
    if (STATE(next) == OFFERED)
      atomic_store(&baton->offered, now_ns()); /* before it lies: it is read where it does */
  } while (!atomic_compare_exchange_weak(&baton->word, &seen, next));
}

void count_call(struct port *port, bool passed)
{
  int64_t now = now_ns();
  atomic_store_explicit(&port->tried, now, memory_order_relaxed);
  if (passed) {
    atomic_store_explicit(&port->last, now, memory_order_relaxed);
    atomic_fetch_add_explicit(&port->passed, 1, memory_order_relaxed);
  } else {
    atomic_fetch_add_explicit(&port->gated, 1, memory_order_relaxed);
  }
}

void count_written(struct port *port)
{
  uint64_t before = atomic_fetch_add_explicit(&port->written, 1, memory_order_relaxed);
  uint32_t at = (uint32_t)(atomic_load_explicit(&port->last, memory_order_relaxed) / 1000);
  atomic_store_explicit(&port->wrote[before % WRITES], at, memory_order_relaxed);
}
