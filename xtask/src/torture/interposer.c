/* Stands between the program and the system (LD_PRELOAD): fails or kills at a chosen call, stops the clock, and writes at the
 * end how many calls of each kind there were and how much memory was held. What it does is told by the environment:
 *
 *   TORTURE_CALL=rename|sync|write|open|read  TORTURE_AT=N  TORTURE_HOW=0 (kill) or errno  TORTURE_LASTING=1 (all later ones too)
 *   TORTURE_CLOCK=1 (no time passes)  TORTURE_REPORT=FILE
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { RENAME, SYNC, WRITE, OPEN, READ, CALLS };
static const char *const NAMES[CALLS] = {"rename", "sync", "write", "open", "read"};

static atomic_long counts[CALLS];
static int chosen = -1, how, lasting, no_time;
static long at;
static char report[4096];

static long number(const char *name) {
    const char *text = getenv(name);
    return text ? atol(text) : 0;
}

__attribute__((constructor)) static void begin(void) {
    const char *call = getenv("TORTURE_CALL"), *file = getenv("TORTURE_REPORT");
    for (int i = 0; call && i < CALLS; i++)
        if (!strcmp(call, NAMES[i])) chosen = i;
    at = number("TORTURE_AT");
    how = (int)number("TORTURE_HOW");
    lasting = (int)number("TORTURE_LASTING");
    no_time = (int)number("TORTURE_CLOCK");
    if (file) snprintf(report, sizeof report, "%s", file);
    /* Programs that this one starts are left alone. */
    unsetenv("LD_PRELOAD");
}

__attribute__((destructor)) static void end(void) {
    struct rusage usage;
    FILE *out = report[0] ? fopen(report, "w") : NULL;
    if (!out) return;
    for (int i = 0; i < CALLS; i++) fprintf(out, "%s %ld\n", NAMES[i], atomic_load(&counts[i]));
    getrusage(RUSAGE_SELF, &usage);
    fprintf(out, "peak %ld\n", usage.ru_maxrss);
    fclose(out);
}

/* Whether this call is to fail; it does not return when the program is to be killed. */
static int strikes(int call) {
    long n = atomic_fetch_add(&counts[call], 1) + 1;
    if (call != chosen || n < at || (n > at && !lasting)) return 0;
    if (!how) kill(getpid(), SIGKILL);
    errno = how;
    return 1;
}

/* A file on a disk: no pipe, terminal, or file of /proc, which have no length. */
static int on_disk(int fd, int is_read) {
    struct stat info;
    return !fstat(fd, &info) && S_ISREG(info.st_mode) && (!is_read || info.st_size > 0);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

int rename(const char *from, const char *to) { return strikes(RENAME) ? -1 : REAL(rename)(from, to); }
int fsync(int fd) { return strikes(SYNC) ? -1 : REAL(fsync)(fd); }
int fdatasync(int fd) { return strikes(SYNC) ? -1 : REAL(fdatasync)(fd); }

ssize_t write(int fd, const void *bytes, size_t count) {
    return on_disk(fd, 0) && strikes(WRITE) ? -1 : REAL(write)(fd, bytes, count);
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    return on_disk(fd, 0) && strikes(WRITE) ? -1 : REAL(writev)(fd, parts, count);
}
ssize_t read(int fd, void *bytes, size_t count) {
    return on_disk(fd, 1) && strikes(READ) ? -1 : REAL(read)(fd, bytes, count);
}
ssize_t readv(int fd, const struct iovec *parts, int count) {
    return on_disk(fd, 1) && strikes(READ) ? -1 : REAL(readv)(fd, parts, count);
}

/* What the process has used so far: peak of memory, bytes read, time on processors. None of it repeats. */
static int is_measurement(const char *path) {
    return !strcmp(path, "/proc/self/status") || !strcmp(path, "/proc/self/io") || !strcmp(path, "/proc/self/stat");
}

/* Of what is opened only new files are counted. */
static int opened(__typeof__(&open) real, const char *path, int flags, mode_t mode) {
    if (no_time && is_measurement(path)) {
        errno = ENOENT;
        return -1;
    }
    return flags & O_CREAT && strikes(OPEN) ? -1 : real(path, flags, mode);
}
static mode_t mode_of(int flags, va_list more) { return flags & O_CREAT ? (mode_t)va_arg(more, int) : 0; }

int open(const char *path, int flags, ...) {
    va_list more;
    va_start(more, flags);
    mode_t mode = mode_of(flags, more);
    va_end(more);
    return opened(REAL(open), path, flags, mode);
}
int open64(const char *path, int flags, ...) {
    va_list more;
    va_start(more, flags);
    mode_t mode = mode_of(flags, more);
    va_end(more);
    return opened(REAL(open64), path, flags, mode);
}

/* Deadlines are counted from here and then waited for by the system's own clock: a time that is long past would end every
 * wait at once, so it stands still in the future. */
int clock_gettime(clockid_t clock, struct timespec *now) {
    if (!no_time) return REAL(clock_gettime)(clock, now);
    now->tv_sec = 4000000000;
    now->tv_nsec = 0;
    return 0;
}
