/* The page of shared memory between the manager and the nodes that it gates.
 *
 * One file for each system. The manager creates it, and fills in nodes and ports; each process maps it. page.py has the
 * same layout; midstride_layout() lets a test compare the two. Every field that both sides write is atomic.
 *
 * The header, the batons and the nodes have a fixed place. Behind them are the ports, in no order: each says which node has
 * it. The file grows where it has no free one, so it is mapped at the length that it may reach.
 */
#ifndef MIDSTRIDE_PAGE_H
#define MIDSTRIDE_PAGE_H

#include "baton.h"

#include <stdatomic.h>
#include <stdint.h>

#define PAGE_MAGIC UINT64_C(0x4d4944535452444e)
#define PAGE_VERSION 3 /* counted up whenever the meaning or the place of a field changes */
#define NODES 512      /* fewer than the word of a baton can name */
#define BATONS 1024
#define MOST_PORTS 65536
#define GROWTH 64 /* how many ports the file grows by */
#define NAME 256

/* Of a port: what its endpoints are. NODE: it is no port, and names a ROS node of the process instead of a topic. */
enum { UNUSED = 0, OUTPUT = 1, INPUT = 2, SERVER = 3, CLIENT = 4, NODE = 5 };
enum { CLOSED = 0, OPEN = 1 };  /* of a port: gate */
/* Of a node. LISTS: the library adds a port for each topic, open. NAMES_ONE: a `__node:=` that is for all nodes of the
 * process names the first of them alone. */
enum { IN_USE = 1, LISTS = 2, NAMES_ONE = 4 };

struct port {
  _Atomic uint32_t kind;
  _Atomic uint32_t flags;
  _Atomic uint32_t gate;
  _Atomic uint32_t baton;   /* index + 1 in `batons`; 0: the gate alone decides */
  _Atomic uint64_t passed;  /* messages published, or received */
  _Atomic uint64_t gated;   /* messages held back, or dropped */
  _Atomic int64_t last;     /* when one passed last: CLOCK_MONOTONIC, ns; 0: never */
  _Atomic int64_t tried;    /* the same, whether it passed or not */
  _Atomic uint32_t endpoints; /* how many endpoints of the node have this topic */
  _Atomic uint32_t matched;   /* with how many endpoints they are matched, as the middleware of the process sees it */
  _Atomic uint32_t kept;      /* whether a message is kept that was written behind the gate */
  _Atomic uint32_t half;      /* half the period of an output with a rate (us); 0: any write is a slot */
  _Atomic uint32_t node;      /* index + 1 of the node that has it; 0: free */
  uint32_t number;            /* which of the ports of that node it is, from 0 */
  uint32_t spare[14];
  char topic[NAME]; /* its full name; of a server or a client, that of the service */
};

/* What is gated as one: a process, or one of several ROS nodes in it. */
struct node {
  _Atomic uint32_t pid;  /* 0: none of its endpoints has been created yet */
  _Atomic uint32_t bell; /* a futex: counted up to have the helper thread look at once */
  _Atomic uint32_t beat; /* when it was set aside for the instance (CLOCK_MONOTONIC, s), and from then on counted up by the
                          * helper thread each time it has looked */
  _Atomic uint32_t used; /* flags; 0: free */
  uint32_t process;      /* index + 1 of the node that its process was started as, which may be this one: the helper thread
                          * of the process knows the bell and the beat of that one only */
  _Atomic uint32_t unlisted; /* how many nodes of the process the page had no room to name */
  uint32_t spare[10];
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

struct page {
  struct head head;
  struct baton batons[BATONS];
  struct node nodes[NODES];
  struct port ports[];
};

#endif
