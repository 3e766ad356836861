/* The baton: which writer may write.
 *
 * The baton is one word, so that each step of the protocol is one compare-and-swap. docs/protocols/baton.md has the
 * protocol in words. The functions baton_* are pure: they say what a step makes of the word.
 * tests/foreign/test_baton_model.py explores every order of these steps.
 */
#ifndef MIDSTRIDE_BATON_H
#define MIDSTRIDE_BATON_H

#include <stdint.h>

enum { RATED = 1, OFFERS = 2, TIMED = 4, KEEPS = 8, SHUT = 16, ANSWERS = 32 }; /* of a port: flags, see below */

/* -- the word ------------------------------------------------------------------------------------------------------
 *
 *   bits  0 to  7  writers: calls of the holder that are publishing now
 *   bits  8 to 11  state
 *   bits 12 to 23  holder, as index of its node + 1; the other two likewise, 0 where there is none
 *   bits 24 to 35  successor: takes the baton when it is offered
 *   bits 36 to 47  predecessor: takes it back if the holder dies
 *   bits 48 to 63  generation: counted up whenever the holder or the state changes
 */
enum { HELD = 0, OFFERED = 1, FENCED = 2 };

#define FIELD(word, shift, bits) ((unsigned)((word) >> (shift)) & ((1u << (bits)) - 1))
#define WRITERS(word) FIELD(word, 0, 8)
#define STATE(word) FIELD(word, 8, 4)
#define HOLDER(word) FIELD(word, 12, 12)
#define SUCCESSOR(word) FIELD(word, 24, 12)
#define PREDECESSOR(word) FIELD(word, 36, 12)
#define GENERATION(word) FIELD(word, 48, 16)
#define MOST_WRITERS 255u
/* How often a successor must have come while the holder was publishing, until the holder leaves it a slot. */
#define COLLISIONS 2u

static inline uint64_t baton_word(unsigned generation, unsigned predecessor, unsigned successor, unsigned holder,
                                  unsigned state, unsigned writers)
{
  return (uint64_t)(generation & 0xffff) << 48 | (uint64_t)predecessor << 36 | (uint64_t)successor << 24 |
         (uint64_t)holder << 12 | (uint64_t)state << 8 | writers;
}

/* What a writer may do: publish; not publish; not publish, and that was one of its slots; find out whether the holder
 * lives, and ask again; try again, since too many calls are publishing. */
enum verdict { PASS, HOLD_BACK, SKIP, ASK, BUSY };

/* A writer `me` (index + 1) is about to publish on a port with `flags`. `waited`: whether its part of the time is over;
 * `collided`: whether there have been COLLISIONS; `dead`: whether the holder is (-1: not known). For PASS, `next` is what
 * the word must become before it publishes.
 *
 * RATED: the port has a rate, so its writes are slots, but for one that comes sooner than half a period after the baton
 * was offered (not `waited`): a writer that was late catches up, and leaves its successor no time. TIMED: no port that
 * shares the baton has one; `waited` is whether `patience` is over, or was before a message on which the baton was
 * offered. SHUT: an input that a probe closes, as long as the lease of the page lasts. ANSWERS: in answers.h. */
static inline enum verdict baton_enter(uint64_t word, unsigned me, unsigned flags, int waited, int collided, int dead,
                                       uint64_t *next)
{
  unsigned state = STATE(word), generation = GENERATION(word);
  if (HOLDER(word) == me) {
    if (state == HELD) {
      if (WRITERS(word) == MOST_WRITERS)
        return BUSY;
      *next = word + 1;
      return PASS;
    }
    if (state != OFFERED)
      return HOLD_BACK;
    if (flags & RATED ? waited && collided : flags & TIMED && !waited)
      return SKIP;
    /* The successor has not come, or nothing of this output may be lost: publish, and offer it again afterwards. */
    *next = baton_word(generation + 1, PREDECESSOR(word), SUCCESSOR(word), me, HELD, 1);
    return PASS;
  }
  if (SUCCESSOR(word) == me && state == OFFERED && flags & (RATED | TIMED)) {
    *next = baton_word(generation + 1, HOLDER(word), 0, me, HELD, 1);
    return PASS;
  }
  if ((SUCCESSOR(word) == me || PREDECESSOR(word) == me) && state != FENCED) {
    if (dead < 0)
      return ASK;
    if (dead) {
      *next = baton_word(generation + 1, 0, 0, me, HELD, 1);
      return PASS;
    }
  }
  return HOLD_BACK;
}

/* The writer that entered at `entered` (its `next`) has published. Returns what the word must become; the same if it was
 * moved by force meanwhile. OFFERS: after a write on this port, the baton is offered where a successor is named.
 * `again`: it was offered before this write. */
static inline uint64_t baton_leave(uint64_t word, uint64_t entered, unsigned flags, int again)
{
  if (HOLDER(word) != HOLDER(entered) || GENERATION(word) != GENERATION(entered) || WRITERS(word) == 0)
    return word; /* while calls are publishing, the generation changes by force only */
  word--;
  if (STATE(word) == HELD && WRITERS(word) == 0 && SUCCESSOR(word) != 0 && (flags & OFFERS || again))
    return baton_word(GENERATION(word) + 1, PREDECESSOR(word), SUCCESSOR(word), HOLDER(word), OFFERED, 0);
  return word;
}

/* -- the manager's steps; each returns what the word must become, and the same word where it may not ----------------- */

/* `holder` is to offer the baton to `successor`; at once where no write of it has to be waited for. */
static inline uint64_t baton_name(uint64_t word, unsigned holder, unsigned successor, int at_once)
{
  if (HOLDER(word) != holder || STATE(word) != HELD)
    return word;
  if (at_once && WRITERS(word) == 0)
    return baton_word(GENERATION(word) + 1, 0, successor, holder, OFFERED, 0);
  return baton_word(GENERATION(word), 0, successor, holder, HELD, WRITERS(word));
}

/* Withdraw that: the holder stays. What the successor has taken already is not taken from it. */
static inline uint64_t baton_withdraw(uint64_t word, unsigned holder)
{
  if (HOLDER(word) != holder || STATE(word) == FENCED)
    return word;
  return baton_word(GENERATION(word) + (STATE(word) != HELD), 0, 0, holder, HELD, WRITERS(word));
}

/* The new holder keeps it even if it dies: the old one is going to be removed. */
static inline uint64_t baton_settle(uint64_t word, unsigned holder)
{
  if (HOLDER(word) != holder)
    return word;
  return baton_word(GENERATION(word), 0, SUCCESSOR(word), holder, STATE(word), WRITERS(word));
}

/* `successor` takes what it is offered without a message to publish. */
static inline uint64_t baton_take(uint64_t word, unsigned successor)
{
  if (SUCCESSOR(word) != successor || STATE(word) != OFFERED)
    return word;
  return baton_word(GENERATION(word) + 1, HOLDER(word), 0, successor, HELD, 0);
}

/* No further call of the holder may publish. Those that are publishing are counted until they have. */
static inline uint64_t baton_fence(uint64_t word, unsigned holder)
{
  if (HOLDER(word) != holder || STATE(word) == FENCED)
    return word;
  return baton_word(GENERATION(word), 0, 0, holder, FENCED, WRITERS(word));
}

static inline uint64_t baton_lift(uint64_t word, unsigned holder)
{
  if (HOLDER(word) != holder || STATE(word) != FENCED)
    return word;
  return baton_word(GENERATION(word), 0, 0, holder, HELD, WRITERS(word));
}

/* Give it to `holder`, whoever has it: only where that one has died, or is fenced and publishes nothing. */
static inline uint64_t baton_give(uint64_t word, unsigned holder)
{
  return baton_word(GENERATION(word) + 1, 0, 0, holder, HELD, 0);
}

#endif
