/* The requests to a role's services that are known one by one (known.c). */
#ifndef MIDSTRIDE_KNOWN_H
#define MIDSTRIDE_KNOWN_H

#include "gate.h"

#pragma GCC visibility push(hidden)

/* The word of a request, for a component with Midstride's API, to which rclpy does not say whose a request is:
 *
 *   bit  0        CLAIMED: a node has claimed it
 *   bit  1        ARRIVED: it has arrived at a component, which holds it
 *   bits 2 to 63  from when its client has sent it, and its number: the same at every server, and unique
 */
#define CLAIMED UINT64_C(1)
#define ARRIVED UINT64_C(2)

/* Neither flag is set, and it is not 0. */
static inline uint64_t identity_of(int64_t sent, int64_t number)
{
  uint64_t identity = mixed(mixed(0, (uint64_t)sent), (uint64_t)number) & ~(CLAIMED | ARRIVED);
  return identity ? identity : 4;
}

/* What has places in the part of a role, which processes take one after the other; the locks of the nodes come first. */
enum places { OF_CLIENTS = 1, OF_ANSWERS, OF_KNOWN };

/* No place in `known`. */
#define NOWHERE UINT32_MAX

/* Whether a component with Midstride's API shares the role, or has lately. */
bool is_mixed(struct requests *requests);
/* Have the other processes wait (F_WRLCK), or go on; `file` is the page, `first` the part of its first role. The kernel releases
 * the lock of one that dies; one that is stopped while it has the lock is not waited for. */
void lock_part(int file, const struct requests *requests, const struct requests *first, enum places places, short type);
/* Note a request with its flags; its place. */
uint32_t note_known(struct requests *requests, uint64_t entry);
/* Whether a request is noted with these flags, at another place than `but`. */
bool is_known(struct requests *requests, uint64_t entry, uint32_t but);

#pragma GCC visibility pop
#endif
