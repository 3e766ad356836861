/* Goals of ROS actions that the page has no room for: their node alone knows which they are, until there is room. */
#include "serving.h"

#include <stdlib.h>
#include <string.h>

struct beyond {
  struct beyond *next;
  uint8_t goal[16];
  unsigned me;
  uint32_t port; /* as in the place of a goal */
  bool ended;
};
static struct beyond *first;
static pthread_mutex_t beyond_lock = PTHREAD_MUTEX_INITIALIZER; /* `lock` comes first */

static struct beyond **place_of(const uint8_t *goal)
{
  struct beyond **place = &first;
  while (*place && memcmp((*place)->goal, goal, sizeof (*place)->goal) != 0)
    place = &(*place)->next;
  return place;
}

static void forget(struct beyond **place)
{
  struct beyond *known = *place;
  *place = known->next;
  if (!known->ended)
    atomic_fetch_sub(&page->nodes[known->me - 1].beyond, 1);
  atomic_fetch_sub(&page->nodes[known->me - 1].apart, 1);
  free(known);
}

void accept_beyond(const struct entry *entry, const struct subject *subject)
{
  struct beyond *accepted = calloc(1, sizeof *accepted);
  if (!accepted)
    return;
  memcpy(accepted->goal, subject->goal, sizeof accepted->goal);
  accepted->me = entry->me;
  accepted->port = (uint32_t)(entry->port - page->ports) + 1;
  pthread_mutex_lock(&beyond_lock);
  accepted->next = first;
  first = accepted;
  atomic_fetch_add(&page->nodes[entry->me - 1].apart, 1);
  atomic_fetch_add(&page->nodes[entry->me - 1].beyond, 1);
  pthread_mutex_unlock(&beyond_lock);
}

void drop_beyond(unsigned me, uint32_t port)
{
  pthread_mutex_lock(&beyond_lock);
  for (struct beyond **place = &first; *place;)
    if ((*place)->me == me && (*place)->port == port)
      forget(place);
    else
      place = &(*place)->next;
  pthread_mutex_unlock(&beyond_lock);
}

unsigned step_beyond(const uint8_t *goal, enum goal_event event)
{
  pthread_mutex_lock(&beyond_lock);
  struct beyond **place = place_of(goal), *known = *place;
  unsigned me = known ? known->me : 0;
  if (known && event == END && !known->ended) {
    known->ended = true;
    atomic_fetch_sub(&page->nodes[me - 1].beyond, 1);
  } else if (known && (event == FETCH || event == EXPIRE)) {
    forget(place);
  }
  pthread_mutex_unlock(&beyond_lock);
  return me;
}

bool is_beyond(unsigned me, const uint8_t *goal)
{
  if (!atomic_load(&page->nodes[me - 1].apart))
    return false;
  pthread_mutex_lock(&beyond_lock);
  struct beyond *known = *place_of(goal);
  bool own = known && known->me == me;
  pthread_mutex_unlock(&beyond_lock);
  return own;
}

unsigned other_beyond(unsigned me, bool in_progress)
{
  uint32_t requests = atomic_load(&page->nodes[me - 1].requests);
  for (unsigned index = 0; index < NODES; index++) {
    struct node *other = &page->nodes[index];
    if (index + 1 != me && atomic_load(&other->used) && atomic_load(&other->requests) == requests &&
        atomic_load(in_progress ? &other->beyond : &other->apart) && !has_ended(index + 1))
      return index + 1;
  }
  return 0;
}

void place_beyond(void)
{
  pthread_mutex_lock(&beyond_lock);
  for (struct beyond **place = &first; *place;) {
    struct beyond *known = *place;
    struct requests *requests = requests_of(known->me);
    struct goal *goal = requests ? reserve_goal(requests, known->me, known->port, known->goal) : NULL;
    if (!goal) {
      place = &known->next;
      continue;
    }
    /* A place that is reserved is its owner's alone. */
    atomic_store(&goal->word, goal_word(atomic_load(&goal->word), known->me, known->ended ? ENDED : ACCEPTED));
    forget(place);
  }
  pthread_mutex_unlock(&beyond_lock);
}
