/* For the manager, and for tests: the steps that the manager takes in the page, and the pure functions of the headers. */
#include "gate.h"

#include <string.h>

EXPORT void midstride_layout(uint32_t *sizes)
{
  uint32_t layout[] = {PAGE_VERSION,        sizeof(struct page),     sizeof(struct baton),   sizeof(struct node),
                       sizeof(struct port), sizeof(struct requests), sizeof(struct receipts)};
  memcpy(sizes, layout, sizeof layout);
}

EXPORT int midstride_enter(uint64_t word, unsigned index, unsigned flags, int waited, int collided, int dead,
                           uint64_t *next)
{
  return (int)baton_enter(word, index, flags, waited, collided, dead, next);
}

EXPORT uint64_t midstride_leave(uint64_t word, uint64_t entered, unsigned flags, int again)
{
  return baton_leave(word, entered, flags, again);
}

enum step { NAME_SUCCESSOR, WITHDRAW, SETTLE, FENCE, LIFT, GIVE, TAKE };

/* What a step of the manager makes of a word. `index`: of the holder; of the new one for GIVE and TAKE. */
EXPORT uint64_t midstride_step(uint64_t word, int step, unsigned index, unsigned successor, int at_once)
{
  switch ((enum step)step) {
  case NAME_SUCCESSOR:
    return baton_name(word, index, successor, at_once);
  case WITHDRAW:
    return baton_withdraw(word, index);
  case SETTLE:
    return baton_settle(word, index);
  case FENCE:
    return baton_fence(word, index);
  case LIFT:
    return baton_lift(word, index);
  case GIVE:
    return baton_give(word, index);
  case TAKE:
    return baton_take(word, index);
  }
  return word;
}

/* Take a step with the word of a baton in shared memory; returns the word before. */
EXPORT uint64_t midstride_take_step(struct baton *baton, int step, unsigned index, unsigned successor, int at_once)
{
  uint64_t seen = atomic_load(&baton->word), next;
  do {
    next = midstride_step(seen, step, index, successor, at_once);
    if (STATE(next) == OFFERED && STATE(seen) != OFFERED)
      atomic_store(&baton->offered, now_ns());
    if (SUCCESSOR(next) != SUCCESSOR(seen))
      atomic_store(&baton->collisions, 0);
  } while (!atomic_compare_exchange_weak(&baton->word, &seen, next));
  return seen;
}

EXPORT int midstride_is_dead(int file, unsigned index)
{
  return is_dead(file, index);
}

/* The page in `file`, for the manager; NULL where it has another layout. It stays for as long as the process lives. */
EXPORT struct page *midstride_map(int file)
{
  uint32_t version;
  return map_page(file, &version);
}

/* A port for the node `index`, as its index + 1; 0 where the page cannot grow. */
EXPORT unsigned midstride_reserve_port(struct page *shared, int file, unsigned index)
{
  struct port *port = reserve_port(shared, file, index + 1);
  return port ? (unsigned)(port - shared->ports) + 1 : 0;
}

EXPORT uint64_t midstride_requests_step(struct page *shared, int file, unsigned number, int step, unsigned node,
                                        int64_t until)
{
  struct requests *requests = requests_at(shared, number);
  uint64_t word = atomic_load(&requests->word), next;
  if (step == GIVE_REQUESTS)
    atomic_store(&requests->until, until);
  do {
    unsigned now = ANSWERING(word);
    int lives = now && atomic_load(&shared->nodes[now - 1].pid) && !is_dead(file, now);
    next = step == GIVE_REQUESTS ? requests_give(word, node, lives) : requests_forget(word, node);
  } while (!atomic_compare_exchange_weak(&requests->word, &word, next));
  return next;
}

/* The result of a goal is kept beside the page, so its place, whose word was `word`, is free. */
EXPORT void midstride_forget_goal(struct page *shared, unsigned number, unsigned place, uint64_t word)
{
  struct goal *goal = &requests_at(shared, number)->goals[place];
  atomic_compare_exchange_strong(&goal->word, &word, goal_step(word, OWNER(word), EXPIRE));
}

/* The same of a word; any other step is that of the node itself. */
EXPORT uint64_t midstride_requests_word(uint64_t word, int step, unsigned node, int lives)
{
  if (step == GIVE_REQUESTS)
    return requests_give(word, node, lives);
  return step == FORGET ? requests_forget(word, node) : requests_take_back(word, node);
}

/* What the steps of goals.h make of a word, and whose turn it is. RESERVE: `number` says whether the owner has ended. */
EXPORT uint64_t midstride_goal(uint64_t word, int reserve, unsigned node, int number)
{
  return reserve ? goal_reserve(word, node, number) : goal_step(word, node, (enum goal_event)number);
}

EXPORT int midstride_turn(int about, unsigned node, int own, unsigned owner, int in_flight, int added, int missing)
{
  return (int)turn_of((enum about)about, node, own, owner, in_flight, added, missing);
}

EXPORT int midstride_requests_claim(uint64_t word, uint32_t number, uint64_t *next)
{
  return requests_claim(word, number, next);
}

/* What answers.h says of an answer. */
EXPORT int midstride_answers_may(uint64_t number, int timed, uint64_t last, unsigned by, unsigned me)
{
  return answers_may(number, timed, last, by, me);
}
