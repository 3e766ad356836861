/* Which of two nodes answers a request to a service.
 *
 * Every server of a service receives every request. Two words decide, each step is one compare-and-swap of one of them,
 * and docs/protocols/services.md has the protocol in words. The functions requests_* are pure.
 * tests/foreign/test_requests_model.py explores every order of their steps.
 */
#ifndef MIDSTRIDE_REQUESTS_H
#define MIDSTRIDE_REQUESTS_H

#include <stdint.h>

/* -- the word of a role: which of its nodes answers what arrives -----------------------------------------------------
 *
 *   bits  0 to 11  answering: index of its node + 1
 *   bits 12 to 23  before: the one that answered before it, until that has ended; 0: none
 *   bit  24        begun: the one before has answered what it had taken, or had its time for that
 *   bits 32 to 63  generation: counted up whenever another node is to answer
 */
#define ANSWERING(word) ((unsigned)(word) & 0xfff)
#define BEFORE(word) ((unsigned)((word) >> 12) & 0xfff)
#define BEGUN (UINT64_C(1) << 24)

static inline uint64_t requests_word(uint64_t word, unsigned answering, unsigned before)
{
  uint64_t generation = (word >> 32) + 1;
  return generation << 32 | (before ? 0 : BEGUN) | (uint64_t)before << 12 | answering;
}

/* `node` is to answer from now on; it begins when the one before, if that lives, has answered what it has taken. */
static inline uint64_t requests_give(uint64_t word, unsigned node, int lives)
{
  if (ANSWERING(word) == node)
    return word;
  return requests_word(word, node, lives ? ANSWERING(word) : 0);
}

/* The one that answers has died: the one before answers again. The same word where that is not `node`. */
static inline uint64_t requests_take_back(uint64_t word, unsigned node)
{
  return BEFORE(word) == node ? requests_word(word, node, 0) : word;
}

/* `node` has ended: the one before is forgotten. */
static inline uint64_t requests_forget(uint64_t word, unsigned node)
{
  return BEFORE(word) == node ? (word & ~(UINT64_C(0xfff) << 12)) | BEGUN : word;
}

/* -- the word of a client: which of its requests have been claimed ---------------------------------------------------
 *
 *   bits  0 to 31  the highest number that has been claimed
 *   bits 32 to 47  the WINDOW numbers below it: whether each has been, the next lower one in bit 32
 *   bits 48 to 63  tag: of which client it is, in case its place was given to another
 *
 * A number further below counts as claimed: a client's requests arrive in order.
 */
#define WINDOW 16
#define TAG(word) ((unsigned)((word) >> 48))

/* Claim request `number`; for the one that does it first `next` is what the word must become. False: it has been. */
static inline int requests_claim(uint64_t word, uint32_t number, uint64_t *next)
{
  uint32_t highest = (uint32_t)word;
  uint64_t window = (word >> 32) & 0xffff, tag = word >> 48 << 48;
  int32_t above = (int32_t)(number - highest);
  if (above > 0) {
    window = above > WINDOW ? 0 : ((window << 1 | 1) << (above - 1)) & 0xffff;
    *next = tag | window << 32 | number;
    return 1;
  }
  int below = -above - 1;
  if (above == 0 || below >= WINDOW || window >> below & 1)
    return 0;
  *next = word | UINT64_C(1) << (32 + below);
  return 1;
}

#endif
