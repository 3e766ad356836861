/* The page of shared memory between the manager and the nodes that it gates.
 *
 * One file for each system. The manager creates it, and fills in nodes and ports; each process maps it. page_layout.py has the
 * same layout; midstride_layout() lets a test compare the two. Every field that both sides write is atomic.
 *
 * The header, the batons and the nodes have a fixed place. Behind them are the ports, in no order: each says which node has
 * it. The file grows where it has no free one, so it is mapped at the length that it may reach. Behind the last place of a
 * port is what is known of requests, one part for each role, of which the file has those that are used.
 */
#ifndef MIDSTRIDE_PAGE_H
#define MIDSTRIDE_PAGE_H

#include "answers.h"
#include "baton.h"
#include "goals.h"
#include "requests.h"

#include <stdatomic.h>
#include <stdint.h>

#define PAGE_MAGIC UINT64_C(0x4d4944535452444e)
#define PAGE_VERSION 20 /* counted up whenever the meaning or the place of a field changes */
#define PAGE_OLDEST 19  /* the oldest that is used as well: each part has the same place, and what is new is 0 there */
#define NODES 512      /* fewer than the word of a baton can name */
#define BATONS 1024
#define MOST_PORTS 65536
#define GROWTH 64 /* how many ports the file grows by */
#define CLIENTS 512 /* how many clients of its services are known for a role at once */
#define GOALS 256 /* how many goals of its ROS actions are known for a role at once */
#define ADDED 4 /* how many requests to cancel many goals can be under way at two nodes of a role at once */
#define KNOWN 4096 /* how many of the requests to a role's services are known one by one */
#define ANSWERED 256 /* of how many pairs of an output and a writer of what it answers is the last answer known for a role */
#define LATEST 8 /* of how many requests that a server has answered it is known how long each took */
#define WRITES 128 /* of how many messages of an output it is known when they were written */
#define RECEIPTS 16384 /* of how many messages it is known that an input has received them */
#define NAME 256
#define MARK 16 /* of the identity of an endpoint in the graph */

/* Of a port: what its endpoints are. NODE: it is no port, and names a ROS node of the process instead of a topic. */
enum { UNUSED = 0, OUTPUT = 1, INPUT = 2, SERVER = 3, CLIENT = 4, NODE = 5 };
enum { CLOSED = 0, OPEN = 1 };  /* of a port: gate */
/* Of an output: what becomes of intra-process communication (within.c). KEEP_OUT: its publishers are not to take part;
 * KEPT_OUT: one would have; TAKES_PART: one does. */
enum { KEEP_OUT = 1, KEPT_OUT = 2, TAKES_PART = 4 };
/* Of a node. LISTS: the library adds a port for each topic, open. NAMES_ONE: a `__node:=` that is for all nodes of the
 * process names the first of them alone. LEAVES: it is about to be unloaded from a process that goes on. HAS_AGENT: it is a
 * component with Midstride's API, which shares the requests to its services with a node that has the library. NOTED: it has
 * noted what it had handled before. */
enum { IN_USE = 1, LISTS = 2, NAMES_ONE = 4, LEAVES = 8, HAS_AGENT = 16, NOTED = 32 };

struct port {
  _Atomic uint32_t kind;
  _Atomic uint32_t flags;
  _Atomic uint32_t gate;
  _Atomic uint32_t baton;   /* index + 1 in `batons`; 0: the gate alone decides */
  _Atomic uint64_t passed;  /* messages published, or received; of a server, requests that this node has claimed */
  _Atomic uint64_t gated;   /* messages held back, or dropped; of a server, requests held now that no node has claimed */
  _Atomic int64_t last;     /* when one passed last: CLOCK_MONOTONIC, ns; 0: never */
  _Atomic int64_t tried;    /* the same, whether it passed or not */
  _Atomic uint32_t endpoints; /* how many endpoints of the node have this topic */
  _Atomic uint32_t matched;   /* with how many endpoints they are matched, as the middleware of the process sees it; of a
                               * server, how many clients it shows while two nodes have the service */
  _Atomic uint32_t kept;      /* whether a message is kept that was written behind the gate */
  _Atomic uint32_t half;      /* half the period of an output with a rate (us); 0: any write is a slot */
  _Atomic uint32_t node;      /* index + 1 of the node that has it; 0: free */
  uint32_t number;            /* which of the ports of that node it is, from 0 */
  /* Of a server: since when its oldest request is not answered, and since when no executor waits for its requests, not even
   * to take one (CLOCK_MONOTONIC, ns; 0: there is none, or one waits, or it is not known). */
  _Atomic int64_t waiting;
  _Atomic int64_t busy;
  _Atomic uint32_t answered;     /* how many requests it has answered */
  _Atomic uint32_t took[LATEST]; /* how long the last ones took (us); that of number n is at n % LATEST, the first is 0 */
  /* Of an output: how many messages in a row, up to the last one, have each answered an input, and one of those that have
   * arrived meanwhile; how often that has ended; and of which inputs, a bit for each topic. Of which of them the other node has
   * answered one that this node had taken: from then on, it has taken all that the other one has still to answer. */
  _Atomic uint32_t in_step;
  _Atomic uint32_t falls;
  _Atomic uint64_t answers;
  _Atomic uint64_t overlaps;
  _Atomic uint32_t recorded; /* of an input: whether what it receives is noted, in a file of the port beside the page */
  _Atomic uint32_t within; /* flags, as above */
  /* Of an output: how many messages its node has published, each once, whether it went through the middleware or stayed in
   * the process; how many of them were given to subscriptions of the process by intra-process communication; and when the
   * last ones were published (CLOCK_MONOTONIC, us, modulo 2^32): number n is at n % WRITES, the first is 0. */
  _Atomic uint64_t written;
  _Atomic uint64_t inside;
  _Atomic uint32_t wrote[WRITES];
  char topic[NAME]; /* its full name; of a server or a client, that of the service */
};

/* A message that an input has received. */
struct receipt {
  _Atomic uint64_t place; /* how many were noted before it, and itself; 0: it is being written */
  int64_t received;       /* CLOCK_MONOTONIC, ns */
  int64_t sent;           /* as the middleware says, Unix time, ns; 0: it does not */
  uint64_t number;        /* at its writer; 0: the middleware does not say */
  uint8_t writer[16];
};

/* The last messages that an input has received; that of place n is at (n - 1) % RECEIPTS. */
struct receipts {
  _Atomic uint64_t count; /* of all */
  struct receipt last[RECEIPTS];
};

/* What has become of goals: so many were accepted, ended, or ended as they were cancelled; and how many requests were
 * about goals that no node knew. */
enum { GOALS_ACCEPTED, GOALS_ENDED, GOALS_CANCELLED, GOALS_UNKNOWN, COUNTED };

/* What is gated as one: a process, or one of several ROS nodes in it. It may be given away once it is not `used` and has no
 * `pid`, or that process has ended. */
struct node {
  _Atomic uint32_t pid;  /* 0: none of its endpoints has been created yet */
  _Atomic uint32_t bell; /* a futex: counted up to have the helper thread look at once */
  _Atomic uint32_t beat; /* when it was set aside for the instance (CLOCK_MONOTONIC, s), and from then on counted up by the
                          * helper thread each time it has looked */
  _Atomic uint32_t used; /* flags; 0: free */
  uint32_t process;      /* index + 1 of the node that its process was started as, which may be this one: the helper thread
                          * of the process knows the bell and the beat of that one only */
  _Atomic uint32_t unlisted; /* how many nodes of the process the page had no room to name */
  _Atomic uint32_t requests; /* index + 1 of the part that has the requests to its role; 0: it answers each */
  _Atomic uint32_t unanswered; /* how many requests it has claimed, and not answered yet */
  _Atomic int64_t answered; /* when it answered last: CLOCK_MONOTONIC, ns; 0: never */
  _Atomic uint32_t unstated; /* index + 1 in `batons`: which node of the role may write on topics that are no ports; 0: each */
  _Atomic uint32_t asked; /* the number of the last request that the manager has put into a file for this node alone */
  _Atomic uint32_t marked; /* whether `mark` is set: then the graph shows its process under it */
  uint8_t mark[MARK];      /* the identity of the first publisher of its process, which begins with that of the process */
  _Atomic uint32_t cancels; /* whether the helper thread is to cancel the goals that it has */
  _Atomic uint32_t beyond; /* how many goals it has in progress that the page had no room for */
  _Atomic uint32_t goals[COUNTED]; /* what has become of its goals, in all */
  _Atomic uint32_t apart; /* how many goals the page had no room for, also those that have ended, and whose results no
                           * client has fetched */
  _Atomic uint32_t loading; /* index + 1 of the one that a container, which this is, is being asked to load; 0: of none */
  _Atomic uint32_t loads; /* how many requests to load a node it has taken and not answered yet */
  _Atomic uint32_t calls; /* of a node of a container: how many threads are in a call of it, as far as the library sees that */
  char instance[NAME];
  char name[NAME]; /* the full name of its ROS node; empty: all those of the process that are no other's */
};

struct baton {
  _Atomic uint64_t word;
  _Atomic int64_t offered;  /* when it was offered last: CLOCK_MONOTONIC, ns */
  _Atomic int64_t patience; /* for how long a writer without a rate leaves it to its successor (ns) */
  _Atomic uint64_t collisions; /* how often the successor has come while the holder was publishing, since it was named */
  uint64_t padding[4];      /* a cache line each */
};

struct head {
  uint64_t magic;
  uint32_t version;
  uint32_t size;         /* of what is before the ports; then the sizes of the others */
  uint32_t node_size;
  uint32_t port_size;
  _Atomic int64_t lease; /* CLOCK_MONOTONIC, ns: a probe that has ended without a word keeps no input closed */
  _Atomic uint32_t room; /* for how many ports the file has room */
  uint32_t spare[7];
};

/* A client of a role's services. */
struct client {
  _Atomic uint64_t id;   /* from the identity of its writer; 0: free */
  _Atomic uint64_t word; /* which of its requests have been claimed */
  _Atomic uint64_t seen; /* index + 1 of the successor, and the number (48 bits) of the first one that it has received */
  _Atomic int64_t last;  /* when one was claimed or seen last: CLOCK_MONOTONIC, ns */
};

/* A goal of a ROS action that a node of the role has accepted, or is about to. */
struct goal {
  _Atomic uint64_t word;
  _Atomic uint64_t id[2]; /* its UUID */
  _Atomic int64_t at;     /* when it was asked for: CLOCK_MONOTONIC, ns */
  _Atomic uint32_t port;  /* index + 1 of the port of the service that takes such goals, at its owner */
  uint32_t spare;
};

/* action_msgs/msg/GoalInfo */
struct goal_info {
  uint8_t id[16];
  int32_t seconds;
  uint32_t nanoseconds;
};

/* The goals that a node has cancelled for a request which another one answers. */
struct added {
  _Atomic uint64_t word; /* bits 0 to 11: index of the node + 1; bit 12: it is whole; bits 32 to 63: generation */
  _Atomic uint64_t client; /* of the request */
  _Atomic int64_t number;
  _Atomic uint32_t count;
  uint32_t spare;
  struct goal_info goals[GOALS];
};
#define WHOLE (UINT64_C(1) << 12)

/* Of an output of a role, and a writer of what it answers: the last answer (answers.h). */
struct answered {
  _Atomic uint64_t id; /* from both; 0: free */
  _Atomic uint64_t number;
  _Atomic int64_t at; /* when it was answered: CLOCK_MONOTONIC, ns */
  _Atomic uint32_t by; /* index + 1 of the node */
  uint32_t spare;
};

/* The requests to the services of a role, and the messages that it answers. */
struct requests {
  _Atomic uint64_t word;   /* which node answers */
  _Atomic int64_t until;   /* how long the one before has for what it has taken: CLOCK_MONOTONIC, ns */
  _Atomic int64_t paused;  /* until when no node takes any, since state moves from one to the other; 0: not paused */
  /* Until when one of the nodes is a component with Midstride's API (known.c): CLOCK_MONOTONIC, ns; 0: none is. */
  _Atomic int64_t mixed;
  _Atomic uint32_t shared; /* whether two nodes have them */
  _Atomic uint32_t knows;  /* how many were put into `known`, in all */
  /* What has arrived before then is not answered: a component has died that had not noted what it had handled.
   * CLOCK_MONOTONIC, ns. */
  _Atomic int64_t lost;
  uint32_t spare[4];
  struct client clients[CLIENTS];
  struct goal goals[GOALS];
  struct added added[ADDED];
  struct answered answered[ANSWERED];
  _Atomic uint64_t known[KNOWN]; /* the last ones, by identity_of() and flags; that of number n is at n % KNOWN */
};

struct page {
  struct head head;
  struct baton batons[BATONS];
  struct node nodes[NODES];
  struct port ports[];
};

#endif
