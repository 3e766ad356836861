/* Which of two nodes has a goal of a ROS action, and which of them is to answer what is asked about it.
 *
 * A node that has accepted a goal keeps it until its end; what is asked about it (its result, a request to cancel it) is
 * that node's to answer, whichever node answers all else. docs/protocols/services.md has the protocol in words. The
 * functions are pure; tests/foreign/test_goals_model.py explores every order of their steps.
 */
#ifndef MIDSTRIDE_GOALS_H
#define MIDSTRIDE_GOALS_H

#include <stdint.h>

/* -- the word of a goal ----------------------------------------------------------------------------------------------
 *
 *   bits  0 to 11  owner: index of its node + 1
 *   bits 12 to 15  state
 *   bits 32 to 63  generation: counted up whenever the place is taken for another goal
 *
 * NO_GOAL: the place is free. RESERVED: the request for the goal is about to be claimed. ASKED: it has been, and is not
 * answered. ACCEPTED. ENDED: it has a result, which no client has fetched. FETCHED: one has; the node keeps it for others.
 */
enum goal_state { NO_GOAL, RESERVED, ASKED, ACCEPTED, ENDED, FETCHED };
#define OWNER(word) ((unsigned)(word) & 0xfff)
#define GOAL_STATE(word) ((enum goal_state)((unsigned)((word) >> 12) & 0xf))

enum goal_event { CLAIM, ACCEPT, REJECT, END, FETCH, EXPIRE };

static inline uint64_t goal_word(uint64_t word, unsigned owner, enum goal_state state)
{
  return word >> 32 << 32 | (uint64_t)state << 12 | owner;
}

/* The place is reserved for a goal of `node`; the same word where it has another one, whose node may still need it. */
static inline uint64_t goal_reserve(uint64_t word, unsigned node, int owner_has_ended)
{
  if (GOAL_STATE(word) != NO_GOAL && GOAL_STATE(word) != FETCHED && !owner_has_ended)
    return word;
  return goal_word(word + (UINT64_C(1) << 32), node, RESERVED);
}

/* What an event of its owner makes of it; the same word where it changes nothing. */
static inline uint64_t goal_step(uint64_t word, unsigned node, enum goal_event event)
{
  enum goal_state state = GOAL_STATE(word), next = state;
  if (OWNER(word) != node)
    return word;
  switch (event) {
  case CLAIM:
    next = state == RESERVED ? ASKED : state;
    break;
  case ACCEPT:
    next = state == ASKED ? ACCEPTED : state;
    break;
  case REJECT:
    next = state == RESERVED || state == ASKED ? NO_GOAL : state;
    break;
  case END:
    next = state == ASKED || state == ACCEPTED ? ENDED : state;
    break;
  case FETCH:
    next = state == ACCEPTED || state == ENDED ? FETCHED : state;
    break;
  case EXPIRE:
    next = state == ENDED || state == FETCHED ? NO_GOAL : state;
    break;
  }
  return next == state ? word : goal_word(word, next == NO_GOAL ? 0 : node, next);
}

/* Whether its node must not end yet. */
static inline int goal_in_flight(uint64_t word)
{
  return GOAL_STATE(word) >= RESERVED && GOAL_STATE(word) <= ENDED;
}

/* Whether requests about it are known to be for its owner. */
static inline int goal_is_known(uint64_t word)
{
  return GOAL_STATE(word) >= ASKED;
}

/* -- whose turn it is with a request ---------------------------------------------------------------------------------
 *
 * ABOUT_NONE: it is about no goal that there is already. ABOUT_ONE: its result, or to cancel it. ABOUT_MANY: to cancel all
 * goals, or those up to a time: each node with such goals cancels its own, and one of them answers for both.
 */
enum about { ABOUT_NONE, ABOUT_ONE, ABOUT_MANY };
/* ADD: cancel its own goals, and leave the list of them for the node that answers. */
enum turn { WAIT, ANSWER, ADD };

/* `own`: this node answers what is about no goal. `owner`: the node that has the goal, 0 where none that lives does.
 * `in_flight`: this node has goals that it may be about; `added`: it has left the list of them; `missing`: another node
 * has such goals, and there is still time for it to leave the list. */
static inline enum turn turn_of(enum about about, unsigned node, int own, unsigned owner, int in_flight, int added,
                                int missing)
{
  if (about == ABOUT_ONE && owner)
    return owner == node ? ANSWER : WAIT;
  if (about == ABOUT_MANY) {
    if (own)
      return missing ? WAIT : ANSWER;
    return in_flight && !added ? ADD : WAIT;
  }
  return own ? ANSWER : WAIT;
}

#endif
