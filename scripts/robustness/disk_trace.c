/* Preloaded library for scripts/robustness/power_loss.py: records every change of the files below one folder, in order,
   with its data. Built with: cc -shared -fPIC -O1 -o disk_trace.so disk_trace.c -ldl -lpthread */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

struct event { /* followed by the path, the second path and the data */
    char kind[8];
    uint64_t inode, offset, size;
    uint32_t path, second;
} __attribute__((packed));

static char folder[4096];
static int trace = -1;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

void disk_trace_start(const char *below, const char *file) {
    snprintf(folder, sizeof folder, "%s/", below);
    trace = REAL(open)(file, O_WRONLY | O_CREAT | O_TRUNC | O_APPEND, 0600);
}

static void put(const char *kind, uint64_t inode, uint64_t offset, const void *data, uint64_t size, const char *path,
                const char *second) {
    struct event event = {"", inode, offset, size, strlen(path), strlen(second)};
    strncpy(event.kind, kind, sizeof event.kind);
    pthread_mutex_lock(&lock);
    REAL(write)(trace, &event, sizeof event);
    REAL(write)(trace, path, event.path);
    REAL(write)(trace, second, event.second);
    if (data)
        REAL(write)(trace, data, size);
    pthread_mutex_unlock(&lock);
}

void disk_trace_mark(long number) { put("mark", number, 0, 0, 0, "", ""); }

static int below(const char *path) { return trace >= 0 && folder[0] && !strncmp(path, folder, strlen(folder)); }

/* Return the path of an open file or folder in ``path`` and whether it lies below the folder. */
static int path_of(int file, char *path, size_t size) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, size - 2);
    if (length < 0)
        return 0;
    path[length] = 0;
    if (!strncmp(path, folder, strlen(folder) - 1) && path[strlen(folder) - 1] == 0)
        strcpy(path + length, "/");
    return below(path);
}

static uint64_t inode_of(int file) {
    struct stat status;
    return fstat(file, &status) ? 0 : status.st_ino;
}

static ssize_t wrote(int file, const void *data, ssize_t count, off_t offset) {
    char path[4096];
    if (count > 0 && file != trace && path_of(file, path, sizeof path))
        put("write", inode_of(file), offset, data, count, path, "");
    return count;
}

ssize_t write(int f, const void *b, size_t n) {
    off_t offset = trace >= 0 ? lseek(f, 0, SEEK_CUR) : 0;
    return wrote(f, b, REAL(write)(f, b, n), offset);
}
ssize_t pwrite(int f, const void *b, size_t n, off_t o) { return wrote(f, b, REAL(pwrite)(f, b, n, o), o); }
ssize_t pwrite64(int f, const void *b, size_t n, off64_t o) { return wrote(f, b, REAL(pwrite64)(f, b, n, o), o); }

static int did(const char *kind, int file, int result, uint64_t offset) {
    char path[4096];
    if (!result && path_of(file, path, sizeof path))
        put(kind, inode_of(file), offset, 0, 0, path, "");
    return result;
}

int fsync(int f) { return did("sync", f, REAL(fsync)(f), 0); }
int fdatasync(int f) { return did("sync", f, REAL(fdatasync)(f), 0); }
int ftruncate(int f, off_t n) { return did("cut", f, REAL(ftruncate)(f, n), n); }
int ftruncate64(int f, off64_t n) { return did("cut", f, REAL(ftruncate64)(f, n), n); }

static int named(const char *kind, const char *path, const char *second, int result) {
    if (!result && (below(path) || below(second)))
        put(kind, 0, 0, 0, 0, path, second);
    return result;
}

int rename(const char *a, const char *b) { return named("rename", a, b, REAL(rename)(a, b)); }
int link(const char *a, const char *b) { return named("link", a, b, REAL(link)(a, b)); }
int unlink(const char *a) { return named("unlink", a, "", REAL(unlink)(a)); }

static int opened(const char *path, int flags, int is_new, int file) {
    if (file >= 0 && below(path)) {
        if (is_new && (flags & O_CREAT))
            put("create", inode_of(file), 0, 0, 0, path, "");
        else if (flags & O_TRUNC)
            put("cut", inode_of(file), 0, 0, 0, path, "");
    }
    return file;
}

#define OPEN(name)                                                                                                     \
    int name(const char *path, int flags, ...) {                                                                       \
        va_list list;                                                                                                  \
        va_start(list, flags);                                                                                         \
        mode_t mode = va_arg(list, mode_t);                                                                            \
        va_end(list);                                                                                                  \
        int is_new = below(path) && access(path, F_OK);                                                                \
        return opened(path, flags, is_new, REAL(name)(path, flags, mode));                                             \
    }
OPEN(open)
OPEN(open64)
