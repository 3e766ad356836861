/* Which of two nodes answers a message: a cut by input.
 *
 * A node that answers messages takes one, and publishes what it makes of it. Both nodes of a hand-over take each message, so
 * the answer of one of them is enough, and it is missing if neither publishes it. The page knows for each output, and each
 * writer of what is answered, which message was answered last, and by which node. The one that has the baton (baton.h)
 * writes that down before it publishes an answer; the other one keeps its answers until they have been given.
 *
 * docs/protocols/baton.md has the protocol in words. tests/foreign/test_answers_model.py explores every order of its steps.
 */
#ifndef MIDSTRIDE_ANSWERS_H
#define MIDSTRIDE_ANSWERS_H

#include "baton.h"

#include <stdint.h>

/* A message that a node has taken. */
struct input {
  uint64_t topic;  /* a bit for its topic */
  uint64_t writer; /* from the identity of its writer */
  uint64_t number; /* its number at that writer; 0: none */
  int timed;       /* the middleware does not number messages: it is the time at which it was written (ns) */
};

/* A clock was set back if a message seems to have been written so long (ns) before the one that was answered last. */
#define SET_BACK UINT64_C(10000000000)

/* Whether a node `me` (index + 1) with the baton is to publish its answer to input `number`. `last`: the one that was
 * answered last, by the node `by`; 0: none. A node takes each input once, and what it answers out of order is its own. */
static inline int answers_may(uint64_t number, int timed, uint64_t last, unsigned by, unsigned me)
{
  return by == me || number > last || (timed && last - number > SET_BACK);
}

/* Whether the ports of the baton are handed over between two inputs; else what is kept is as KEEPS has it. */
static inline int answers_decide(unsigned flags)
{
  return (flags & (ANSWERS | TIMED)) == (ANSWERS | TIMED);
}

#endif
