/* Goals of ROS actions: the steps of goals.h, in the page. */
#include "serving.h"

#include <string.h>

/* How long the node that answers a request to cancel many goals waits for the list of the other one (ns). */
#define ADDING INT64_C(1000000000)
/* How long a request about a goal that a node does not know is left to another one that has goals beyond the page (ns). */
#define CLAIMING INT64_C(1000000000)

struct subject subject_of(const struct entry *entry, const void *request)
{
  static const uint8_t none[16];
  struct subject subject = {ABOUT_NONE, {0}};
  if (entry->service == OTHER)
    return subject;
  const struct goal_info *info = request;
  memcpy(subject.goal, info->id, sizeof subject.goal);
  if (entry->service == GET_RESULT)
    subject.about = ABOUT_ONE;
  else if (entry->service == CANCEL_GOAL) {
    bool many = memcmp(info->id, none, sizeof none) == 0 || info->seconds || info->nanoseconds;
    subject.about = many ? ABOUT_MANY : ABOUT_ONE;
  }
  return subject;
}

struct goal *find_goal(struct requests *requests, const uint8_t *id)
{
  uint64_t parts[2];
  memcpy(parts, id, sizeof parts);
  for (unsigned index = 0; index < GOALS; index++) {
    struct goal *goal = &requests->goals[index];
    if (goal_is_known(atomic_load(&goal->word)) && atomic_load(&goal->id[0]) == parts[0] &&
        atomic_load(&goal->id[1]) == parts[1])
      return goal;
  }
  return NULL;
}

void step_goal(struct goal *goal, unsigned me, enum goal_event event)
{
  uint64_t word = atomic_load(&goal->word);
  while (!atomic_compare_exchange_weak(&goal->word, &word, goal_step(word, me, event)))
    ;
}

struct goal *reserve_goal(struct requests *requests, unsigned me, uint32_t port, const uint8_t *id)
{
  for (unsigned tries = 0; tries < GOALS; tries++) {
    struct goal *found = NULL;
    uint64_t word = 0;
    bool free = false;
    for (unsigned index = 0; index < GOALS && !free; index++) {
      struct goal *goal = &requests->goals[index];
      uint64_t seen = atomic_load(&goal->word);
      bool ended = GOAL_STATE(seen) != NO_GOAL && has_ended(OWNER(seen));
      free = GOAL_STATE(seen) == NO_GOAL || ended;
      if (goal_reserve(seen, me, ended) != seen &&
          (free || !found || atomic_load(&goal->at) < atomic_load(&found->at))) {
        found = goal;
        word = seen;
      }
    }
    if (!found)
      return NULL;
    if (atomic_compare_exchange_strong(&found->word, &word, goal_reserve(word, me, true))) {
      uint64_t parts[2];
      memcpy(parts, id, sizeof parts);
      atomic_store(&found->id[0], parts[0]);
      atomic_store(&found->id[1], parts[1]);
      atomic_store(&found->at, now_ns());
      atomic_store(&found->port, port);
      return found;
    }
  }
  return NULL;
}

/* Whether a goal is of the ROS action of `entry`. */
bool is_of_action(const struct goal *goal, const struct entry *entry)
{
  uint32_t port = atomic_load(&goal->port);
  const char *own = entry->port->topic, *other = port && port <= MOST_PORTS ? page->ports[port - 1].topic : "";
  size_t length = (size_t)(strrchr(own, '/') - own) + 1;
  return strncmp(own, other, length) == 0 && strcmp(other + length, "send_goal") == 0;
}

enum turn turn_with(struct requests *requests, const struct entry *entry, const struct subject *subject,
                    const struct request_id *id, int64_t at, bool added, bool own)
{
  bool in_flight = atomic_load(&page->nodes[entry->me - 1].beyond) != 0, missing = false;
  unsigned owner = 0;
  if (subject->about == ABOUT_ONE) {
    struct goal *goal = find_goal(requests, subject->goal);
    if (!goal) {
      bool waits = now_ns() - at < CLAIMING;
      owner = is_beyond(entry->me, subject->goal) ? entry->me : waits ? other_beyond(entry->me, false) : 0;
      goal = owner ? NULL : find_goal(requests, subject->goal); /* there may be room for it by now */
    }
    owner = goal ? OWNER(atomic_load(&goal->word)) : owner;
    owner = owner && has_ended(owner) ? 0 : owner;
  }
  for (unsigned index = 0; subject->about == ABOUT_MANY && index < GOALS; index++) {
    struct goal *goal = &requests->goals[index];
    uint64_t word = atomic_load(&goal->word);
    if (!goal_in_flight(word) || !is_of_action(goal, entry))
      continue;
    if (OWNER(word) == entry->me)
      in_flight = true;
    else if (now_ns() - at < ADDING && !has_ended(OWNER(word)) && !find_added(requests, OWNER(word), id))
      missing = true;
  }
  if (subject->about == ABOUT_MANY && !missing && now_ns() - at < ADDING) {
    unsigned other = other_beyond(entry->me, true);
    missing = other && !find_added(requests, other, id);
  }
  return turn_of(subject->about, entry->me, own, owner, in_flight, added, missing);
}

void count_goal(unsigned me, unsigned what)
{
  atomic_fetch_add(&page->nodes[me - 1].goals[what], 1);
}

/* Something has happened to a goal of this process. `counts`: as what it counts once it has ended. */
static void on_goal(const struct goal_info *info, enum goal_event event, unsigned counts)
{
  pthread_mutex_lock(&lock);
  unsigned owner = step_beyond(info->id, event);
  for (struct table *table = &first_table; table; table = atomic_load(&table->next))
    for (unsigned index = 0; index < ENTRIES; index++) {
      struct entry *entry = &table->entries[index];
      const void *endpoint = atomic_load(&entry->endpoint);
      struct requests *requests =
          endpoint && endpoint != REMOVED && entry->service == SEND_GOAL ? requests_of(entry->me) : NULL;
      struct goal *goal = requests ? find_goal(requests, info->id) : NULL;
      if (goal && OWNER(atomic_load(&goal->word)) == entry->me) {
        owner = entry->me;
        step_goal(goal, entry->me, event);
      }
    }
  if (owner && event == END)
    count_goal(owner, counts);
  pthread_mutex_unlock(&lock);
}

/* rcl_action_goal_event_t */
enum { GOAL_EVENT_SUCCEED = 2, GOAL_EVENT_CANCELED = 4 };

EXPORT int rcl_action_update_goal_state(void *handle, int event)
{
  int result = real_rcl_action_update_goal_state()(handle, event);
  struct goal_info info;
  if (page && result == 0 && event >= GOAL_EVENT_SUCCEED && event <= GOAL_EVENT_CANCELED &&
      real_rcl_action_goal_handle_get_info()(handle, &info) == 0)
    on_goal(&info, END, event == GOAL_EVENT_CANCELED ? GOALS_CANCELLED : GOALS_ENDED);
  return result;
}

EXPORT int rcl_action_expire_goals(const void *server, struct goal_info *expired, size_t capacity, size_t *number)
{
  int result = real_rcl_action_expire_goals()(server, expired, capacity, number);
  for (size_t index = 0; page && result == 0 && expired && index < *number && index < capacity; index++)
    on_goal(&expired[index], EXPIRE, COUNTED);
  return result;
}
