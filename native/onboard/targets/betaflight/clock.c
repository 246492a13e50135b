/* A simulated clock for a program written for real time: loaded before the C library, it replaces
 * CLOCK_MONOTONIC, and the process at the other end of a socket grants the time that may pass.
 *
 * The time of the program advances only in its main thread: `nanosleep` adds the requested time and does not sleep,
 * and each reading of the clock adds READING_NS, so a loop that polls the clock ends. At the end of
 * the granted time the main thread reports on the socket and waits for more. Other threads read that time and do not
 * advance it; calls that do not use this clock (select, gettimeofday) keep real time.
 *
 * A datagram that a thread received counts as handled when that thread calls `select` again: then a byte is sent
 * to the second socket. So the controlling process sends state, waits for the byte, and grants the next step; the
 * program's behaviour is a function of the datagrams, not of the machine's load.
 *
 * Sockets: the environment's ALULA_CLOCK_FD and ALULA_HANDLED_FD. Messages are 64-bit nanoseconds, native order.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define READING_NS 200

static _Atomic uint64_t now_ns;
static uint64_t granted_ns;
static int clock_fd = -1, handled_fd = -1;
static __thread int is_main = -1, has_datagram;
static ssize_t (*real_recvfrom)(int, void*, size_t, int, struct sockaddr*, socklen_t*);
static int (*real_select)(int, fd_set*, fd_set*, fd_set*, struct timeval*);

static int descriptor(const char* name) {
  const char* text = getenv(name);
  return text ? (int)strtol(text, 0, 10) : -1;
}

__attribute__((constructor)) static void prepare(void) {
  clock_fd = descriptor("ALULA_CLOCK_FD");
  handled_fd = descriptor("ALULA_HANDLED_FD");
  *(void**)&real_recvfrom = dlsym(RTLD_NEXT, "recvfrom");
  *(void**)&real_select = dlsym(RTLD_NEXT, "select");
}

static int in_main(void) {
  if (is_main < 0) is_main = syscall(SYS_gettid) == getpid();
  return is_main;
}

static void pass(uint64_t ns) {
  const uint64_t now = atomic_fetch_add(&now_ns, ns) + ns;
  while (now >= granted_ns) {
    if (send(clock_fd, &now, sizeof now, MSG_NOSIGNAL) != (ssize_t)sizeof now) _exit(3); /* the peer is gone */
    if (recv(clock_fd, &granted_ns, sizeof granted_ns, MSG_WAITALL) != (ssize_t)sizeof granted_ns) _exit(3);
  }
}

int clock_gettime(clockid_t clock, struct timespec* result) {
  if (clock != CLOCK_MONOTONIC || clock_fd < 0) return (int)syscall(SYS_clock_gettime, clock, result);
  if (in_main()) pass(READING_NS);
  const uint64_t now = atomic_load(&now_ns);
  result->tv_sec = (time_t)(now / 1000000000U);
  result->tv_nsec = (long)(now % 1000000000U);
  return 0;
}

int nanosleep(const struct timespec* asked, struct timespec* left) {
  if (clock_fd < 0 || !in_main()) return (int)syscall(SYS_nanosleep, asked, left);
  pass((uint64_t)asked->tv_sec * 1000000000U + (uint64_t)asked->tv_nsec);
  return 0;
}

ssize_t recvfrom(int fd, void* data, size_t size, int flags, struct sockaddr* from, socklen_t* length) {
  const ssize_t count = real_recvfrom(fd, data, size, flags, from, length);
  if (count > 0) has_datagram = 1;
  return count;
}

int select(int count, fd_set* readable, fd_set* writable, fd_set* failed, struct timeval* timeout) {
  if (has_datagram && handled_fd >= 0) {
    has_datagram = 0;
    if (send(handled_fd, "", 1, MSG_NOSIGNAL) != 1) _exit(3);
  }
  return real_select(count, readable, writable, failed, timeout);
}
