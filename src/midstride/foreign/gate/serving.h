/* What the files share that are about services and ROS actions. */
#ifndef MIDSTRIDE_SERVING_H
#define MIDSTRIDE_SERVING_H

#include "known.h"

#pragma GCC visibility push(hidden)

/* What a request to a ROS action is about. */
struct subject {
  enum about about;
  uint8_t goal[16];
};

/* A request to a ROS action that the node has taken and not answered yet. */
struct taken {
  struct taken *next;
  struct request_id id;
  struct subject subject;
  struct goal *goal; /* that it asks for; NULL: it asks for none, or the page had no room */
  bool adds;         /* another node answers it: it gets the list of what this one has cancelled */
  bool own;          /* the library has made it */
};

/* A request that this node may have to answer later. */
struct held {
  struct held *next;
  struct request_info info;
  serialized bytes;
  struct subject subject;
  struct taken *taken; /* once it is claimed, of a ROS action */
  int64_t at;     /* since when it is held, */
  int64_t came;   /* and when it arrived: CLOCK_MONOTONIC, ns */
  bool claimed;   /* it is this node's to answer */
  bool announced; /* to the callback of its server */
  bool added;     /* it is about many goals, and the node has cancelled its own */
};

/* -- the types of a service (types.c) ---------------------------------------------------------------------------------- */

/* rosidl_message_type_support_t of what a service is asked, and answers; both NULL where they are not known. */
struct message_types {
  const void *request, *response;
};
struct message_types message_types(const struct service_type *type);
/* How many clients of the service `topic` the graph shows to the node `owner`; 0 where it cannot be asked. With `lock`. */
size_t clients_of(const void *owner, const char *topic);

/* -- which node answers a request (claims.c) -------------------------------------------------------------------------- */

/* Whose requests those of the manager to this node alone seem to be. */
#define MANAGER "midstride asks"
/* Of a client in the page: `seen`. */
#define SEEN(index, number) ((uint64_t)(index) << 48 | ((uint64_t)(number) & UINT64_C(0xffffffffffff)))

/* Whether a request is one of the manager to this node alone. */
bool is_asked(const struct request_id *id);
/* Those of the role of the node `me` (index + 1); NULL where it answers each that arrives. */
struct requests *requests_of(unsigned me);
/* lock_part() of the page of this process. */
void lock_places(struct requests *requests, enum places places, short type);
/* Whether the process of the node `index` (+ 1) has ended. A process does not see its own locks. */
bool has_ended(unsigned index);
/* Which other node (index + 1) answers the requests to a role before the node `me` does; 0: this one does. */
unsigned answers_before(struct page *shared, int file, struct requests *requests, unsigned me);
/* Whether the node of `entry` answers the requests to its service now. */
bool answers(struct requests *requests, const struct entry *entry);
/* The node `me` (index + 1) has answered a request that it had claimed, or is not to be waited for any longer. Where it was the
 * last one, the node that answers next is told. */
void count_answered(struct page *shared, struct requests *requests, unsigned me);
/* What distinguishes a client, from the identity of its writer; not 0. */
uint64_t client_key(const struct request_id *id);
/* The part of a client. Where all are used, it is that of the one from which nothing has been heard for longest. */
struct client *client_of(struct requests *requests, uint64_t key);
/* Claim a request; whether this call was the first to do so. `only_look`: do not. */
bool claim_request(struct requests *requests, const struct request_info *info, bool only_look);
/* Note the first request of a client that a successor has received: it receives all later ones, and the node before it
 * answers only what came earlier. */
void note_seen(struct requests *requests, unsigned me, const struct request_id *id);
/* When a request arrived that is taken now: CLOCK_MONOTONIC, ns. */
int64_t arrival(const struct request_info *info);
/* Whether a request that arrived at `came` may have been answered by a component that has died without a note of it. */
bool is_lost(struct requests *requests, int64_t came);

/* -- goals of ROS actions (goals.c) ----------------------------------------------------------------------------------- */

/* What a request to `entry` is about. It is in memory as its type has it, in C as in C++: the UUID of the goal comes first
 * in each, and in one to cancel a time follows. */
struct subject subject_of(const struct entry *entry, const void *request);
struct goal *find_goal(struct requests *requests, const uint8_t *id);
void step_goal(struct goal *goal, unsigned me, enum goal_event event);
/* A place for a goal that the node `me` (index + 1) is about to accept, by the service of `port` (index + 1); NULL where each
 * has one that its node may still need. Of those whose result has been fetched, the one that was asked for first is forgotten. */
struct goal *reserve_goal(struct requests *requests, unsigned me, uint32_t port, const uint8_t *id);
/* Whose turn it is with a request to `entry`, which has arrived at `at`. `own`: whether this node answers what is about no
 * goal. */
enum turn turn_with(struct requests *requests, const struct entry *entry, const struct subject *subject,
                    const struct request_id *id, int64_t at, bool added, bool own);
/* Count what has become of a goal of the node `me` (index + 1), or a request to it about one that is not known. */
void count_goal(unsigned me, unsigned what);

/* -- goals that the page has no room for (beyond.c) ------------------------------------------------------------------- */

/* Such a goal is accepted. */
void accept_beyond(const struct entry *entry, const struct subject *subject);
/* The server of `port` (index + 1) of the node `me` (index + 1), which has accepted such goals, is there no longer. */
void drop_beyond(unsigned me, uint32_t port);
/* END, FETCH or EXPIRE of a goal; index + 1 of its node where it is such a one, else 0. */
unsigned step_beyond(const uint8_t *goal, enum goal_event event);
/* Whether the node `me` (index + 1) has accepted the goal, and there was no room for it. */
bool is_beyond(unsigned me, const uint8_t *goal);
/* Another node of the role of `me` that lives and has such goals, as index + 1; 0 where there is none. `in_progress`: that
 * have not ended. */
unsigned other_beyond(unsigned me, bool in_progress);
/* Find room for them. With `lock`. */
void place_beyond(void);

/* -- goals of two nodes that are cancelled by one request (cancelled.c) ----------------------------------------------- */

/* What a node has added to the answer of a request; NULL where it has not. */
struct added *find_added(struct requests *requests, unsigned index, const struct request_id *id);
/* Leave the list of what this node has cancelled for the one that answers. Where each place is used, the oldest is given
 * up: its request is answered without it. */
void leave_added(struct requests *requests, struct entry *entry, const struct taken *taken, const void *response);
/* Add what other nodes have cancelled to the response of this one. */
void merge_added(struct requests *requests, struct entry *entry, const struct taken *taken, void *response);
/* Have the node cancel all goals that it has, by a request which no other one gets. With `lock`. */
void cancel_all(struct entry *entry);

/* -- requests that are taken and not answered (unanswered.c) ---------------------------------------------------------- */

/* Claim a request for the node of `entry`, which has had to answer it since `since`; false where it has been claimed.
 * `taken`: what is to be remembered of it until it is answered, NULL for that of any other service than those of a ROS
 * action. */
bool begin_request(struct requests *requests, struct entry *entry, const struct request_info *info,
                   const struct subject *subject, int64_t since, struct taken **taken);
/* Remember what the node has taken until it answers. */
void remember(struct entry *entry, struct taken *taken);
/* No longer: it answers. NULL where nothing was remembered. */
struct taken *recall(struct entry *entry, const struct request_id *id);
/* Since when the oldest request of a server is not answered; 0: each is. */
int64_t oldest_of(const struct entry *entry);
/* A request of this node needs no more to be waited for; `sent`: it has been answered. */
void answered(struct entry *entry, struct requests *requests, const struct request_id *id, bool sent);

/* -- requests that are held (held.c) ---------------------------------------------------------------------------------- */

/* Hold a request: another node answers, or is to. Not where it cannot be copied: then it is left to the other one.
 * `added`: this node has taken it, to add to the answer. */
void hold_request(struct entry *entry, const struct request_info *info, const void *request,
                  const struct subject *subject, bool added);
void free_held(struct held *held);
/* Hold one that this node is to answer, and no other. With `lock`. */
void hold_claimed(struct entry *entry, struct held *held);
/* No longer hold any of them, nor remember what is taken. With `lock`. */
void drop_requests(struct entry *entry);
/* Give the node a request that was held; false where none is due. */
bool take_held(struct entry *entry, struct requests *requests, struct request_info *info, void *request);
/* Whose turn it is with one that is held. */
enum turn turn_with_held(struct requests *requests, const struct entry *entry, const struct held *held);
/* Whether a server of the node has a request which it is to take that the middleware does not know of. With `lock`. */
bool is_due(struct entry *entry);
/* For the helper thread, with `lock`. */
void look_at_server(struct entry *entry);

/* -- executors that wait (waits.c) ------------------------------------------------------------------------------------ */

/* Have the executor take what is due. With `lock`. */
void announce(struct entry *entry);

/* -- requests of the manager to this node alone (asked.c) ------------------------------------------------------------- */

/* How many bytes the name of a file of one of them has more than that of the page. */
#define SUFFIX 64
#define FILE_NAME (PATH_MAX + SUFFIX)

/* The bytes of a file, with a 0 behind them; NULL where it cannot be read. */
uint8_t *read_file(const char *name, size_t *length);
/* Hold those that there are for the executor. With `lock`. */
void take_asked(void);
/* Write the response to a request of the manager into its file, which is there once it is whole. */
int respond(const struct entry *entry, const struct request_id *id, const void *response);

/* -- requests to set parameters (settings.c) -------------------------------------------------------------------------- */

/* Note for the manager what the node is about to be asked to set, if that is what it has taken. */
void note_setting(const struct entry *entry, const void *request);

#pragma GCC visibility pop
#endif
