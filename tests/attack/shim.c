/* What a machine may answer: preloaded, it lets calls fail that would write, or lock, files below a folder; and sets the clock.

   SHIM_ROOT   the folder
   SHIM_CALLS  "write": whatever needs space (open that creates, write, mkdir, symlink, rename, truncate, sync); "lock": flock
   SHIM_ERRNO  how they fail
   SHIM_AT     the first of these calls, from 1, that fails, with all after it; counted in each process
   SHIM_MANY   so many fail and no more, as where somebody makes room meanwhile
   SHIM_CLOCK  seconds by which the clock is ahead, or behind
   SHIM_LOG    a file, outside the folder, to which each of these calls is noted: its number, its name and the path
*/
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static int count;

/* Whether a call on this path is to fail; it is counted and noted. */
static int fails(const char *kind, const char *name, const char *path) {
    const char *root = getenv("SHIM_ROOT"), *calls = getenv("SHIM_CALLS"), *at = getenv("SHIM_AT"), *log = getenv("SHIM_LOG");
    const char *many = getenv("SHIM_MANY");
    if (!root || !calls || strcmp(calls, kind) || strncmp(path, root, strlen(root))) return 0;
    int number = __atomic_add_fetch(&count, 1, __ATOMIC_SEQ_CST);
    if (log) {
        char line[PATH_MAX + 64];
        int length = snprintf(line, sizeof line, "%d %s %s\n", number, name, path + strlen(root));
        int file = syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
        if (file >= 0) {
            syscall(SYS_write, file, line, (size_t)length);
            syscall(SYS_close, file);
        }
    }
    if (!at || number < atoi(at) || (many && number >= atoi(at) + atoi(many))) return 0;
    errno = atoi(getenv("SHIM_ERRNO"));
    return 1;
}

static int fails_at(const char *kind, const char *name, int folder, const char *given) {
    char path[2 * PATH_MAX], base[PATH_MAX];
    if (given[0] == '/') return fails(kind, name, given);
    if (folder == AT_FDCWD) {
        if (syscall(SYS_getcwd, base, sizeof base) < 0) return 0;
    } else {
        char link[64];
        snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
        ssize_t length = readlink(link, base, sizeof base - 1);
        if (length < 0) return 0;
        base[length] = 0;
    }
    snprintf(path, sizeof path, "%s/%s", base, given);
    return fails(kind, name, path);
}

static int fails_of(const char *kind, const char *name, int file) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return fails(kind, name, path);
}

#define REAL(type, name, ...) ((type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name))

#define OPEN(name)                                                                     \
    int name(const char *path, int flags, ...) {                                       \
        va_list rest;                                                                  \
        va_start(rest, flags);                                                         \
        int mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, int) : 0;            \
        va_end(rest);                                                                  \
        if (flags & O_CREAT && access(path, F_OK) && fails_at("write", "open", AT_FDCWD, path)) return -1; \
        return REAL(int, name, const char *, int, ...)(path, flags, mode);             \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                                                   \
    int name(int folder, const char *path, int flags, ...) {                           \
        va_list rest;                                                                  \
        va_start(rest, flags);                                                         \
        int mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, int) : 0;            \
        va_end(rest);                                                                  \
        if (flags & O_CREAT && faccessat(folder, path, F_OK, 0) && fails_at("write", "open", folder, path)) return -1; \
        return REAL(int, name, int, const char *, int, ...)(folder, path, flags, mode); \
    }
OPENAT(openat)
OPENAT(openat64)

ssize_t write(int file, const void *data, size_t size) {
    if (size && fails_of("write", "write", file)) return -1;
    return REAL(ssize_t, write, int, const void *, size_t)(file, data, size);
}

ssize_t writev(int file, const struct iovec *parts, int number) {
    if (fails_of("write", "write", file)) return -1;
    return REAL(ssize_t, writev, int, const struct iovec *, int)(file, parts, number);
}

ssize_t pwrite64(int file, const void *data, size_t size, off64_t at) {
    if (size && fails_of("write", "write", file)) return -1;
    return REAL(ssize_t, pwrite64, int, const void *, size_t, off64_t)(file, data, size, at);
}

ssize_t copy_file_range(int in, off64_t *from, int out, off64_t *to, size_t size, unsigned flags) {
    if (fails_of("write", "write", out)) return -1;
    return REAL(ssize_t, copy_file_range, int, off64_t *, int, off64_t *, size_t, unsigned)(in, from, out, to, size, flags);
}

ssize_t sendfile64(int out, int in, off64_t *at, size_t size) {
    if (fails_of("write", "write", out)) return -1;
    return REAL(ssize_t, sendfile64, int, int, off64_t *, size_t)(out, in, at, size);
}

int mkdir(const char *path, mode_t mode) {
    if (access(path, F_OK) && fails_at("write", "mkdir", AT_FDCWD, path)) return -1;
    return REAL(int, mkdir, const char *, mode_t)(path, mode);
}

int symlink(const char *target, const char *path) {
    if (fails_at("write", "symlink", AT_FDCWD, path)) return -1;
    return REAL(int, symlink, const char *, const char *)(target, path);
}

int rename(const char *from, const char *to) {
    if (fails_at("write", "rename", AT_FDCWD, to)) return -1;
    return REAL(int, rename, const char *, const char *)(from, to);
}

int renameat(int one, const char *from, int other, const char *to) {
    if (fails_at("write", "rename", other, to)) return -1;
    return REAL(int, renameat, int, const char *, int, const char *)(one, from, other, to);
}

int ftruncate64(int file, off64_t size) {
    if (size && fails_of("write", "truncate", file)) return -1;
    return REAL(int, ftruncate64, int, off64_t)(file, size);
}

int fsync(int file) {
    if (fails_of("write", "sync", file)) return -1;
    return REAL(int, fsync, int)(file);
}

int fdatasync(int file) {
    if (fails_of("write", "sync", file)) return -1;
    return REAL(int, fdatasync, int)(file);
}

int flock(int file, int how) {
    if (how != LOCK_UN && fails_of("lock", "flock", file)) return -1;
    return REAL(int, flock, int, int)(file, how);
}

static long ahead(void) {
    const char *seconds = getenv("SHIM_CLOCK");
    return seconds ? atol(seconds) : 0;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = REAL(int, clock_gettime, clockid_t, struct timespec *)(clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) now->tv_sec += ahead();
    return failed;
}

int gettimeofday(struct timeval *now, void *zone) {
    int failed = REAL(int, gettimeofday, struct timeval *, void *)(now, zone);
    if (!failed) now->tv_sec += ahead();
    return failed;
}

time_t time(time_t *place) {
    time_t now = REAL(time_t, time, time_t *)(NULL) + ahead();
    if (place) *place = now;
    return now;
}
