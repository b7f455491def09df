/* A library to preload: it lets calls of the system fail that concern files below one folder. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#define FILES 4096
static char root[4096];
static int armed, error_number, lasts;
static long first, calls, failed;
static unsigned char watched[FILES];

/* The call number `number`, from 1 on, fails with `error`; with `all` every later one, too. */
void faults_arm(const char *folder, long number, int error, int all) {
    strncpy(root, folder, sizeof root - 1);
    first = number; error_number = error; lasts = all; calls = failed = 0; armed = 1;
}
long faults_disarm(void) { armed = 0; return failed; }

static int below(const char *path) { return armed && path && !strncmp(path, root, strlen(root)); }
static int known(int file) { return armed && file >= 0 && file < FILES && watched[file]; }

/* Whether this call fails. A full disk that stays full refuses only what takes room. */
static int fails(int takes_room) {
    if (lasts && error_number == ENOSPC && !takes_room) return 0;
    calls++;
    if (lasts ? calls < first : calls != first) return 0;
    failed++;
    errno = error_number;
    return 1;
}

#define REAL(name, type) static type real; if (!real) real = (type)dlsym(RTLD_NEXT, name)
typedef int (*open_type)(const char *, int, mode_t);
typedef int (*openat_type)(int, const char *, int, mode_t);
typedef ssize_t (*write_type)(int, const void *, size_t);
typedef ssize_t (*pwrite_type)(int, const void *, size_t, off64_t);
typedef int (*file_type)(int);
typedef int (*truncate_type)(int, off64_t);
typedef int (*two_paths_type)(const char *, const char *);
typedef int (*path_type)(const char *);
typedef int (*mkdir_type)(const char *, mode_t);

static int opened(int file, const char *path) {
    if (file >= 0 && file < FILES) watched[file] = below(path);
    return file;
}

#define OPEN(name) int name(const char *path, int flags, ...) { \
    REAL(#name, open_type); va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); \
    if (below(path) && fails(flags & O_CREAT)) return -1; \
    return opened(real(path, flags, mode), path); }
OPEN(open)
OPEN(open64)
#define OPENAT(name) int name(int folder, const char *path, int flags, ...) { \
    REAL(#name, openat_type); va_list more; va_start(more, flags); mode_t mode = va_arg(more, mode_t); va_end(more); \
    if (below(path) && fails(flags & O_CREAT)) return -1; \
    return opened(real(folder, path, flags, mode), path); }
OPENAT(openat)
OPENAT(openat64)

int close(int file) { REAL("close", file_type); if (file >= 0 && file < FILES) watched[file] = 0; return real(file); }

/* The first write that a full disk refuses is cut: half of it is written. */
ssize_t write(int file, const void *data, size_t size) {
    REAL("write", write_type);
    if (known(file) && fails(1)) return failed == 1 && error_number == ENOSPC && size > 1 ? real(file, data, size / 2) : -1;
    return real(file, data, size);
}
#define PWRITE(name) ssize_t name(int file, const void *data, size_t size, off64_t at) { \
    REAL(#name, pwrite_type); \
    if (known(file) && fails(1)) \
        return failed == 1 && error_number == ENOSPC && size > 1 ? real(file, data, size / 2, at) : -1; \
    return real(file, data, size, at); }
PWRITE(pwrite)
PWRITE(pwrite64)

#define OF_FILE(name) int name(int file) { REAL(#name, file_type); return known(file) && fails(0) ? -1 : real(file); }
OF_FILE(fsync)
OF_FILE(fdatasync)
#define TRUNCATE(name) int name(int file, off64_t size) { \
    REAL(#name, truncate_type); return known(file) && fails(0) ? -1 : real(file, size); }
TRUNCATE(ftruncate)
TRUNCATE(ftruncate64)

int rename(const char *from, const char *to) {
    REAL("rename", two_paths_type); return below(from) && fails(0) ? -1 : real(from, to); }
int unlink(const char *path) { REAL("unlink", path_type); return below(path) && fails(0) ? -1 : real(path); }
int mkdir(const char *path, mode_t mode) { REAL("mkdir", mkdir_type); return below(path) && fails(1) ? -1 : real(path, mode); }
