/* The gate inside a node that does not use Midstride's API, for LD_PRELOAD: what its files share.
 *
 * Wraps the functions of librcl that create, publish and take; the environment names the page of shared memory and the
 * index of the node in it as which the process was started. Further nodes of the process are known by their names. Without
 * a page, and for every topic that is not in it, each function does what librcl does.
 *
 * The manager loads this library, too, for its own steps with the baton (midstride_*, called by foreign/page.py).
 */
#ifndef MIDSTRIDE_GATE_H
#define MIDSTRIDE_GATE_H

#define _GNU_SOURCE
#include "page.h"

#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>

#define EXPORT __attribute__((visibility("default")))
#pragma GCC visibility push(hidden) /* what only the files share */

#include "rcl.h"

static inline int64_t now_ns(void)
{
  struct timespec at;
  clock_gettime(CLOCK_MONOTONIC, &at);
  return at.tv_sec * INT64_C(1000000000) + at.tv_nsec;
}

/* -- the page (page.c) ------------------------------------------------------------------------------------------------ */

/* The page in `file`; NULL where its layout is not that of this library. `version`: which it has, 0: none. */
struct page *map_page(int file, uint32_t *version);
/* Those of a role, by its number from 0. */
struct requests *requests_at(struct page *shared, unsigned number);
/* The lock of a node is held by its process for as long as that lives, and released by the kernel. */
struct flock lock_of(unsigned index, short type);
int is_dead(int file, unsigned index);
/* A port that is now of the node `own` (index + 1), without a kind; the page grows where none is free. NULL: it cannot. */
struct port *reserve_port(struct page *shared, int file, unsigned own);
/* Give a port back that a node no longer has. */
void free_port(struct port *port);
/* The part of a node (index from 0) in the page is free, and its ports are. */
EXPORT void midstride_free(struct page *shared, unsigned index);
/* The steps of the manager, and of a component, with the requests of a role (number from 0); each returns the word after it.
 * GIVE_REQUESTS: `node` (index + 1) is to answer, and the one before has until `until` for what it has taken. */
enum requests_step { GIVE_REQUESTS, FORGET };
EXPORT uint64_t midstride_requests_step(struct page *shared, int file, unsigned number, int step, unsigned node,
                                        int64_t until);
/* Have the helper thread of a node look at once. */
EXPORT void midstride_ring(struct page *shared, unsigned index);

/* -- this process in the page, and its helper thread (process.c) ------------------------------------------------------ */

extern struct page *page; /* NULL: the process has no gate */
extern struct node *node; /* as which the process was started */
extern char page_path[PATH_MAX];
extern int descriptor;       /* of the page */
extern pthread_mutex_t lock; /* of the tables where they change, and of what is kept */

/* How often the helper thread looks without being rung for (ns). */
#define LOOK 100000000L

/* The process has an endpoint: have the helper thread run, and stop before what the middleware keeps of it is destroyed.
 * With `lock`. */
void keep_helping(void);

/* -- the ROS nodes of this process (nodes.c) -------------------------------------------------------------------------- */

/* Which node of the page a node of librcl is, as index + 1: that of its name, or the one that was being loaded when it was
 * created, or else that as which the process was started. With `lock`. */
unsigned node_of(const void *owner);
/* This thread has taken a request to a service of that name, or answers it: from then on, and until then, the nodes that it
 * creates are made by a component that is loaded. */
void begin_loading(const char *service);
void end_loading(const char *service);
/* The node that this thread is loading, as index + 1; 0: none. */
unsigned being_loaded(void);

/* -- the name from the command line (names.c) ------------------------------------------------------------------------- */

/* The name for a node that a program calls `name`, with that context and these options of rcl, from malloc; NULL: the rules of
 * librcl name it, or its program. */
char *given_name(const char *name, const void *context, const void *options);

/* -- the endpoints that have a port (endpoints.c) --------------------------------------------------------------------- */

/* A message that was written behind the gate. */
struct kept {
  struct kept *next;
  struct input input; /* that it answers */
  serialized bytes;
};

/* A request that a server has taken and not answered yet; it may be answered at any time, and by any thread. */
struct unanswered {
  _Atomic uint64_t key; /* of its client and number; 0: free */
  _Atomic int64_t since; /* when it arrived: CLOCK_MONOTONIC, ns; 0: that is about to be noted */
};
/* How many of a server are known at once. */
#define UNANSWERED 32u

/* Which service of a ROS action it is. */
enum service { OTHER, SEND_GOAL, CANCEL_GOAL, GET_RESULT };

/* How many outputs of a node may answer an input; one beyond them is not handed over between two inputs. */
#define MOST_OUTPUTS 8u

/* A publisher, subscription or server of this process whose topic or service is in the page. */
struct entry {
  _Atomic(const void *) endpoint; /* NULL: free; REMOVED: removed */
  struct port *port;
  uint32_t kind; /* as that of its port, which the manager may give to another node before this one is destroyed */
  unsigned me;   /* index + 1 of the node that has it */
  unsigned used; /* index of the port among `used_ports` */
  const void *type;
  bool overdue; /* see `enter` */
  struct kept *kept, **kept_end; /* the last messages that were written behind the gate, the oldest first */
  unsigned keeping, most_kept;   /* how many there are, and may be; of answers to messages, more are kept */
  size_t kept_bytes;
  bool latched;
  uint64_t key; /* from the name of its topic */
  /* Of a subscription: where its receipts are noted; NULL until that is asked for. */
  _Atomic(struct receipts *) receipts;
  /* Of a subscription: the outputs that have answered it, NULL where there are no more; how many of its inputs each of them is
   * still to answer. */
  _Atomic(struct port *) outputs[MOST_OUTPUTS];
  _Atomic uint32_t open;
  /* Of a server: */
  const void *owner; /* its node */
  struct held *held, **end; /* in the order of arrival. With `lock` */
  _Atomic uint32_t holding; /* how many */
  void (*callback)(const void *, size_t);
  const void *context;
  enum service service;
  const void *response; /* the type of what it answers */
  struct taken *taken; /* with `lock` */
  bool cancelled; /* the library has cancelled all goals */
  struct unanswered unanswered[UNANSWERED];
  _Atomic uint32_t responses; /* how many it has sent to such requests */
};

#define ENTRIES 256u
/* Hashed by the address of the endpoint, of a server by that of what it points to (`server_key`). Once this one is full there
 * is a next one, which stays: `find_entry` takes no lock. */
struct table {
  struct entry entries[ENTRIES];
  _Atomic(struct table *) next;
};
extern struct table first_table;
#define REMOVED ((const void *)&first_table)

/* The ports that this process has had endpoints of. With `lock`. */
struct used_port {
  struct port *port;
  unsigned me;
  uint32_t matched;
  uint32_t waiting;
};
extern struct used_port *used_ports;
extern unsigned used_count;

/* NULL where the endpoint has no port. */
struct entry *find_entry(const void *endpoint);
/* What a server (rcl_service_t) is known by: what it points to. rclcpp has a copy of each that rcl makes itself, which is so
 * of the servers of a lifecycle node. */
static inline const void *server_key(const void *service)
{
  return service ? *(const void *const *)service : NULL;
}
static inline struct entry *keyed(const void *key)
{
  return key ? find_entry(key) : NULL;
}
static inline struct entry *find_server(const void *service)
{
  return keyed(server_key(service));
}
/* Where `topic` is a port of this node, or a service, remember the endpoint, and have the helper thread run. False where
 * there is no memory for that: the endpoint would have no gate. */
bool add_entry(const void *endpoint, const void *owner, const char *topic, uint32_t kind, const void *type,
               const void *response);
void remove_entry(const void *endpoint);
/* Remove the servers of a node that ends: their clients are counted by way of it. With `lock`. */
void remove_servers_of(const void *owner);
/* Forget the ports of the node `me` (index + 1), which another process may have from now on; false where it still has an
 * endpoint. With `lock`. */
bool forget_ports(unsigned me);
/* Forget which requests of the manager it has taken (asked.c). With `lock`. */
void forget_asked(unsigned own);

/* -- whether a message may be published (writers.c) ------------------------------------------------------------------- */

/* A call that may publish: `baton` is NULL where the gate alone decides. */
struct pass {
  struct baton *baton;
  uint64_t entered;
  unsigned flags;
  int again;
};

/* A message of the node `own` (index + 1) of `shared` is about to be published. `file`: the open file of that page.
 * `overdue`: whether a successor has let the patience of this port go by. */
bool enter(struct page *shared, unsigned own, int file, struct port *port, bool *overdue, struct pass *pass);
/* It has been. */
void leave(struct pass *pass);
/* A message has passed, or has been held back. */
void count_call(struct port *port, bool passed);
/* A message of an output has been published: it counts once, also where it goes two ways. */
void count_written(struct port *port);

/* -- identities that every process sees alike (cyclone.c) -------------------------------------------------------------- */

/* The one by which the graph shows a publisher; false where it is not known. */
bool graph_identity(const void *publisher, struct identity *identity);
/* That of the writer of a message that was taken; zeros where it has gone. */
void writer_identity(const void *subscription, const struct message_info *info, uint8_t writer[16]);
/* How much of the identity of a client is known elsewhere, from its begin. */
size_t client_length(const struct request_id *id);

/* -- which message a call answers (inputs.c) --------------------------------------------------------------------------- */

/* Mixes `bits` into `key`. */
uint64_t mixed(uint64_t key, uint64_t bits);
uint64_t key_of(const void *bytes, size_t length);
/* What this thread has taken last is answered, as far as it will be: it does something else. */
void end_input(void);
/* It has taken a message. */
void begin_input(struct entry *source, const struct message_info *info, const uint8_t writer[16]);
/* The message that a call on this output answers; its number is 0 where it is none, or the output has answered it already. */
struct input answered_by(struct entry *output);
/* Whether another node has answered it; if so, the page has from then on that the two overlap. */
bool is_answered(const struct entry *output, const struct input *input);
/* Whether the last answer to its writer was that of another node, which has not ended. */
bool another_answers(const struct entry *output, const struct input *input);
/* This node, which has the baton, answers it. */
void note_answer(const struct entry *output, const struct input *input);

/* -- what is measured of a change (receipts.c) ------------------------------------------------------------------------ */

/* Note a message that the node has taken, if the manager wants to know. */
void note_receipt(struct entry *entry, const struct message_info *info, const uint8_t writer[16]);

/* -- what calls a node (calls.c) --------------------------------------------------------------------------------------- */

/* This thread is about to call a node of the page (index + 1; 0: another one, or none). Before `has_to_leave` is asked. */
void begin_call(unsigned me);
/* Whether nothing is to call a node any more, since it is about to be unloaded. */
bool has_to_leave(unsigned me);
/* Of which node a client, or a subscription that has no port, is (rcl_node_t). */
void note_caller(const void *what, const void *owner);
/* The same, as index + 1; 0: not known, or that as which the process was started. */
unsigned called_by(const void *what);
void forget_caller(const void *what);

/* -- what goes past the gate within the process (within.c) ------------------------------------------------------------- */

/* This thread has created a publisher. */
void note_created(const void *publisher);
/* Whether the message that this thread publishes now has been counted, as subscriptions of the process have got it before. */
bool has_counted(const void *publisher);

/* -- what is kept of publishers (publishers.c) ------------------------------------------------------------------------ */

/* How many messages of a publisher are kept at most that were written behind the gate: of a latched one, as many as a
 * subscriber that comes later gets; else the last. */
unsigned most_kept(const struct qos *qos);
/* Whether a subscriber that comes later gets messages of it. */
bool is_latched(const struct qos *qos);
/* Keep at most so many of the messages that are kept, the last ones. With `lock`. */
void discard_kept(struct entry *entry, unsigned remaining);
/* Publish what is kept, in its order, if it may be published now; or forget it, where nothing is to be kept any more. With
 * `lock`. */
void publish_kept(struct entry *entry);

#pragma GCC visibility pop
#endif
