/* Loaded before the C library of a process: from the moment on at which the file $BAD_DISK appears, calls on
   files whose names contain $BAD_DISK_OF fail. The file says how: an errno, and which calls, of
   w (write, truncate), s (sync) and o (open for writing, remove); for instance "5 s". */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

static int strikes(const char *path, char call) {
    const char *told = getenv("BAD_DISK"), *of = getenv("BAD_DISK_OF");
    char text[32] = "";
    if (!told || !of || !strstr(path, of)) return 0;
    int before = errno;
    int file = (int)syscall(SYS_openat, AT_FDCWD, told, O_RDONLY); /* not by the calls below */
    if (file >= 0) {
        if (syscall(SYS_read, file, text, sizeof text - 1) < 0) text[0] = 0;
        syscall(SYS_close, file);
    }
    errno = before;
    if (!strchr(text, call)) return 0;
    errno = atoi(text);
    return 1;
}

static int strikes_open(int file, char call) {
    char link[64], path[4096] = "";
    if (!getenv("BAD_DISK")) return 0;
    int before = errno;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    errno = before;
    return length > 0 && strikes(path, call);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define ON_FILE(result, name, call, arguments, passed) \
    result name arguments { return strikes_open(file, call) ? -1 : NEXT(name) passed; }

ON_FILE(ssize_t, write, 'w', (int file, const void *data, size_t n), (file, data, n))
ON_FILE(ssize_t, pwrite, 'w', (int file, const void *data, size_t n, off_t at), (file, data, n, at))
ON_FILE(ssize_t, pwrite64, 'w', (int file, const void *data, size_t n, off64_t at), (file, data, n, at))
ON_FILE(int, ftruncate, 'w', (int file, off_t n), (file, n))
ON_FILE(int, ftruncate64, 'w', (int file, off64_t n), (file, n))
ON_FILE(int, fsync, 's', (int file), (file))
ON_FILE(int, fdatasync, 's', (int file), (file))

int unlink(const char *path) { return strikes(path, 'o') ? -1 : NEXT(unlink)(path); }

#define OPENING(name) \
    int name(const char *path, int flags, ...) { \
        va_list rest; \
        va_start(rest, flags); \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0; \
        va_end(rest); \
        if (flags & (O_WRONLY | O_RDWR | O_CREAT) && strikes(path, 'o')) return -1; \
        return NEXT(name)(path, flags, mode); \
    }

OPENING(open)
OPENING(open64)
