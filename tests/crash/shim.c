// A hand on the disk of one process: loaded into it with LD_PRELOAD, this sees every system call that touches a file
// under one folder, whichever library makes it, and records the calls that change something, or makes one of them fail.
//
// A seccomp filter lets every call of interest trap into `handle`, except those that `crash_real` makes.
//
//   CRASH_UNDER   the folder, absolute and without links
//   CRASH_LOG     append every change to this file: a line of fields between tabs, then the bytes written
//   CRASH_WHAT    the fault: the name of an error, `short` (half of the bytes), `kill` (before the call), `tear` (half of
//                 the bytes, then kill) or `threads` (none can be started)
//   CRASH_AT      which of the calls that can fail in this way it befalls, from 1; 0 only counts them
//   CRASH_LASTS   set: it befalls all later ones, too
//   CRASH_REPORT  append the call it befell first to this file, and at the end how many it could have befallen
//   CRASH_LATER   seconds by which the clock of the process is ahead
//
// A process with this inside must start no others: the filter outlives its handler.
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/fs.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <ucontext.h>
#include <unistd.h>

long crash_real(long nr, long a, long b, long c, long d, long e, long f);
extern const char crash_after[];

#if defined(__x86_64__)
#define ARCH AUDIT_ARCH_X86_64
__asm__(".text\n.globl crash_real\ncrash_real:\n"
        "mov %rdi,%rax\nmov %rsi,%rdi\nmov %rdx,%rsi\nmov %rcx,%rdx\nmov %r8,%r10\nmov %r9,%r8\nmov 8(%rsp),%r9\nsyscall\n"
        ".globl crash_after\ncrash_after:\nret\n");
#define NUMBER(m) ((m)->gregs[REG_RAX])
#define RESULT(m) ((m)->gregs[REG_RAX])
#define ARGS(m) {(m)->gregs[REG_RDI], (m)->gregs[REG_RSI], (m)->gregs[REG_RDX], (m)->gregs[REG_R10], (m)->gregs[REG_R8], (m)->gregs[REG_R9]}
#elif defined(__aarch64__)
#define ARCH AUDIT_ARCH_AARCH64
__asm__(".text\n.globl crash_real\ncrash_real:\n"
        "mov x8,x0\nmov x0,x1\nmov x1,x2\nmov x2,x3\nmov x3,x4\nmov x4,x5\nmov x5,x6\nsvc #0\n"
        ".globl crash_after\ncrash_after:\nret\n");
#define NUMBER(m) ((m)->regs[8])
#define RESULT(m) ((m)->regs[0])
#define ARGS(m) {(m)->regs[0], (m)->regs[1], (m)->regs[2], (m)->regs[3], (m)->regs[4], (m)->regs[5]}
#else
#error "no trap is written for this processor"
#endif

#define CALL(nr, ...) crash_real(SYS_##nr, __VA_ARGS__)

// What can befall a call.
enum { IO = 1, SPACE = 2, INTR = 4, HALF = 8, FILES = 16, ACCESS = 32, DEATH = 64, READ_ONLY = 128 };
enum { CHANGE = SPACE | ACCESS | IO | DEATH | READ_ONLY, NONE = -1, HERE = -2 };

// A system call: what can befall it, and which arguments are a descriptor and a path; twice.
struct call { int nr; const char *name; int faults, dir, path, dir2, path2; };
static const struct call CALLS[] = {
    {SYS_openat, "open", CHANGE | INTR | FILES, 0, 1, NONE, NONE},
    {SYS_mkdirat, "mkdir", CHANGE, 0, 1, NONE, NONE},
    {SYS_unlinkat, "unlink", ACCESS | IO | DEATH | READ_ONLY, 0, 1, NONE, NONE},
    {SYS_renameat2, "rename", CHANGE, 0, 1, 2, 3},
    {SYS_renameat, "rename", CHANGE, 0, 1, 2, 3},
    {SYS_linkat, "link", CHANGE, 0, 1, 2, 3},
    {SYS_symlinkat, "symlink", CHANGE, 1, 2, NONE, NONE},
    {SYS_newfstatat, "stat", IO | ACCESS, 0, 1, NONE, NONE},
    {SYS_statx, "stat", IO | ACCESS, 0, 1, NONE, NONE},
    {SYS_utimensat, "utimes", IO | ACCESS | DEATH | READ_ONLY, 0, 1, NONE, NONE},
#if defined(__x86_64__)
    {SYS_open, "open", CHANGE | INTR | FILES, HERE, 0, NONE, NONE},
    {SYS_mkdir, "mkdir", CHANGE, HERE, 0, NONE, NONE},
    {SYS_unlink, "unlink", ACCESS | IO | DEATH | READ_ONLY, HERE, 0, NONE, NONE},
    {SYS_rmdir, "rmdir", ACCESS | IO | DEATH | READ_ONLY, HERE, 0, NONE, NONE},
    {SYS_rename, "rename", CHANGE, HERE, 0, HERE, 1},
    {SYS_link, "link", CHANGE, HERE, 0, HERE, 1},
    {SYS_symlink, "symlink", CHANGE, HERE, 1, NONE, NONE},
#endif
    {SYS_read, "read", IO | INTR | HALF, 0, NONE, NONE, NONE},
    {SYS_pread64, "read", IO | INTR | HALF, 0, NONE, NONE, NONE},
    {SYS_getdents64, "list", IO, 0, NONE, NONE, NONE},
    {SYS_write, "write", IO | SPACE | INTR | HALF | DEATH, 0, NONE, NONE, NONE},
    {SYS_pwrite64, "write", IO | SPACE | INTR | HALF | DEATH, 0, NONE, NONE, NONE},
    {SYS_writev, "write", IO | SPACE | INTR | DEATH, 0, NONE, NONE, NONE},
    {SYS_ftruncate, "truncate", IO | INTR | DEATH, 0, NONE, NONE, NONE},
    {SYS_fchmod, "chmod", IO | ACCESS | DEATH | READ_ONLY, 0, NONE, NONE, NONE},
    {SYS_fsync, "sync", IO | SPACE | INTR | DEATH, 0, NONE, NONE, NONE},
    {SYS_fdatasync, "sync", IO | SPACE | INTR | DEATH, 0, NONE, NONE, NONE},
    {SYS_flock, "lock", IO | INTR | DEATH, 0, NONE, NONE, NONE},
    {SYS_fcntl, "lock", IO | INTR | DEATH, 0, NONE, NONE, NONE},
    // Refused, as by a file system that shares no extents: the log knows no bytes that were never written.
    {SYS_ioctl, "clone", 0, 0, NONE, NONE, NONE},
    {SYS_copy_file_range, "clone", 0, 2, NONE, NONE, NONE},
};
enum { COUNT = sizeof CALLS / sizeof *CALLS, PATH = 4096 };

static const struct { const char *name; int error, faults; } FAULTS[] = {
    {"EIO", EIO, IO}, {"ENOSPC", ENOSPC, SPACE}, {"EDQUOT", EDQUOT, SPACE}, {"EINTR", EINTR, INTR},
    {"EMFILE", EMFILE, FILES}, {"EACCES", EACCES, ACCESS}, {"EROFS", EROFS, READ_ONLY},
    {"short", 0, HALF}, {"tear", 0, HALF | DEATH}, {"kill", 0, DEATH},
};

static char under[PATH];
static const char *what, *report;
static int error, faults, lasts, log_fd = -1;
static long at, count, later;
static char busy;

static void lock(void) {
    while (__atomic_test_and_set(&busy, __ATOMIC_ACQUIRE)) CALL(sched_yield, 0, 0, 0, 0, 0, 0);
}

static void unlock(void) { __atomic_clear(&busy, __ATOMIC_RELEASE); }

// The path that a descriptor and a path stand for; whether it is under the folder.
static int find(int dir, const char *path, char *out) {
    char link[64];
    long n = 0;
    if (!path || *path != '/') {
        if (dir == AT_FDCWD) strcpy(link, "/proc/self/cwd");
        else snprintf(link, sizeof link, "/proc/self/fd/%d", dir);
        n = CALL(readlinkat, AT_FDCWD, (long)link, (long)out, PATH - 1, 0, 0);
        if (n < 0) return 0;
        if (path && *path) out[n++] = '/';
    }
    snprintf(out + n, PATH - n, "%s", path ? path : "");
    size_t length = strlen(under);
    return !strncmp(out, under, length) && (out[length] == '/' || !out[length]);
}

static int find_of(const struct call *call, const long *args, int second, char *out) {
    int dir = second ? call->dir2 : call->dir, path = second ? call->path2 : call->path;
    return find(dir == HERE ? AT_FDCWD : (int)args[dir], path == NONE ? NULL : (const char *)args[path], out);
}

static void append(int fd, const void *bytes, size_t length) {
    for (size_t done = 0; done < length;) {
        long n = CALL(write, fd, (long)bytes + done, length - done, 0, 0, 0);
        if (n <= 0) abort();
        done += n;
    }
}

// One line of the log: call, inode, two numbers, time, length of what follows, paths.
static void tell(const char *name, unsigned long inode, long a, long b, size_t length, const char *path, const char *to) {
    static char line[3 * PATH];
    struct timespec now;
    CALL(clock_gettime, CLOCK_REALTIME, (long)&now, 0, 0, 0, 0);
    int n = snprintf(line, sizeof line, "%s\t%lu\t%ld\t%ld\t%ld\t%zu\t%s\t%s\n", name, inode, a, b,
                     now.tv_sec * 1000000000 + now.tv_nsec, length, path, to);
    append(log_fd, line, n);
}

static struct stat look(int dir, const char *path, int flags) {
    struct stat meta = {0};
    CALL(newfstatat, dir, (long)path, (long)&meta, flags, 0, 0);
    return meta;
}

// Makes a call and records what it changed.
static long record(const struct call *call, long nr, const long *args, const char *path) {
    char to[PATH] = "";
    int opens = !strcmp(call->name, "open"), flags = opens ? args[call->path + 1] : 0;
    unsigned long before = opens ? look(AT_FDCWD, path, 0).st_ino : 0;
    if (call->path2 != NONE && !find_of(call, args, 1, to)) return -EXDEV;
    long result = crash_real(nr, args[0], args[1], args[2], args[3], args[4], args[5]);
    if (result < 0) return result;
    int fd = opens ? (int)result : (int)args[0];
    struct stat meta = call->path == NONE || opens ? look(fd, "", AT_EMPTY_PATH) : look(AT_FDCWD, *to ? to : path, AT_SYMLINK_NOFOLLOW);
    if (opens && (flags & O_CREAT) && !before) tell("create", meta.st_ino, meta.st_mode & 07777, 0, 0, path, "");
    else if (opens && (flags & O_TRUNC)) tell("truncate", meta.st_ino, 0, 0, 0, path, "");
    else if (!strcmp(call->name, "write")) {
        struct iovec one = {(void *)args[1], result}, *parts = nr == SYS_writev ? (struct iovec *)args[1] : &one;
        long start = nr == SYS_pwrite64 ? args[3] : CALL(lseek, fd, 0, SEEK_CUR, 0, 0, 0) - result;
        tell("write", meta.st_ino, start, 0, result, path, "");
        for (long left = result; left > 0; left -= parts++->iov_len)
            append(log_fd, parts->iov_base, (long)parts->iov_len < left ? parts->iov_len : (size_t)left);
    } else if (!strcmp(call->name, "truncate")) tell("truncate", meta.st_ino, args[1], 0, 0, path, "");
    else if (!strcmp(call->name, "chmod")) tell("chmod", meta.st_ino, args[1], 0, 0, path, "");
    else if (!strcmp(call->name, "utimes")) tell("utimes", meta.st_ino, meta.st_mtim.tv_sec, meta.st_mtim.tv_nsec, 0, path, "");
    else if (!strcmp(call->name, "sync")) tell(S_ISDIR(meta.st_mode) ? "syncdir" : "sync", meta.st_ino, 0, 0, 0, path, "");
    else if (!strcmp(call->name, "symlink")) tell("symlink", meta.st_ino, 0, 0, 0, path, (const char *)args[0]);
    else if (call->faults & DEATH && call->path != NONE && !opens) tell(call->name, meta.st_ino, 0, 0, 0, path, to);
    return result;
}

static void die(void) {
    CALL(kill, CALL(getpid, 0, 0, 0, 0, 0, 0), SIGKILL, 0, 0, 0, 0);
    for (;;) CALL(sched_yield, 0, 0, 0, 0, 0, 0);
}

static void write_report(const char *line, int length) {
    long fd = CALL(openat, AT_FDCWD, (long)report, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644, 0, 0);
    if (fd < 0) return;
    append(fd, line, length);
    CALL(close, fd, 0, 0, 0, 0, 0);
}

// Lets the fault befall a call.
static long befall(const struct call *call, long nr, long *args, const char *path, long number) {
    if (report && number == at) {
        char line[PATH + 64];
        write_report(line, snprintf(line, sizeof line, "%s %s\n", call->name, path));
    }
    if (error) return -error;
    if (faults & HALF) args[2] /= 2;
    if (!(faults & DEATH)) return crash_real(nr, args[0], args[1], args[2], args[3], args[4], args[5]);
    if (faults & HALF) crash_real(nr, args[0], args[1], args[2], args[3], args[4], args[5]);
    die();
    return 0;
}

// Whether the fault of this process can befall a call with these arguments.
static int can_befall(const struct call *call, const long *args) {
    int open = !strcmp(call->name, "open"), halves = faults & HALF;
    if (!what || !(call->faults & faults) || (open && faults & SPACE && !(args[call->path + 1] & O_CREAT))) return 0;
    if (open && faults & (DEATH | READ_ONLY) && !(args[call->path + 1] & (O_CREAT | O_TRUNC | O_WRONLY | O_RDWR))) return 0;
    return !halves || (call->faults & HALF && args[2] > 1 && (!(faults & DEATH) || !strcmp(call->name, "write")));
}

static long handle_call(long nr, long *args) {
    const struct call *call = CALLS;
    while (call < CALLS + COUNT && call->nr != nr) call++;
    char path[PATH];
    int is_lock = nr != SYS_fcntl || args[1] == F_OFD_SETLK || args[1] == F_OFD_SETLKW;
    int is_clone = nr != SYS_ioctl || args[1] == FICLONE;
    if (call == CALLS + COUNT || !is_lock || !is_clone || !find_of(call, args, 0, path))
        return crash_real(nr, args[0], args[1], args[2], args[3], args[4], args[5]);
    if (!strcmp(call->name, "clone")) return nr == SYS_ioctl ? -EOPNOTSUPP : -EXDEV;
    if (can_befall(call, args)) {
        long number = __atomic_add_fetch(&count, 1, __ATOMIC_SEQ_CST);
        if (at && (number == at || (lasts && number > at))) return befall(call, nr, args, path, number);
    }
    int records = log_fd >= 0 && call->faults & DEATH && strcmp(call->name, "lock");
    if (!records) return crash_real(nr, args[0], args[1], args[2], args[3], args[4], args[5]);
    lock();
    long result = record(call, nr, args, path);
    unlock();
    return result;
}

static void handle(int signal, siginfo_t *info, void *context) {
    (void)signal, (void)info;
    mcontext_t *machine = &((ucontext_t *)context)->uc_mcontext;
    long args[6] = ARGS(machine);
    RESULT(machine) = handle_call(NUMBER(machine), args);
}

static void install(int no_threads) {
    static struct sock_filter code[16 + 2 * COUNT + 8];
    int n = 0;
    uint64_t after = (uint64_t)crash_after;
    uint32_t offset = offsetof(struct seccomp_data, instruction_pointer);
#define STEP(...) code[n++] = (struct sock_filter)__VA_ARGS__
#define LOAD(at) STEP(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, at))
#define UNLESS(value, skipped) STEP(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, value, 0, skipped))
#define RETURN(value) STEP(BPF_STMT(BPF_RET | BPF_K, value))
    LOAD(offset);
    UNLESS((uint32_t)after, 3);
    LOAD(offset + 4);
    UNLESS((uint32_t)(after >> 32), 1);
    RETURN(SECCOMP_RET_ALLOW);
    LOAD(offsetof(struct seccomp_data, nr));
    for (int i = 0; i < COUNT; i++) {
        UNLESS((uint32_t)CALLS[i].nr, 1);
        RETURN(SECCOMP_RET_TRAP);
    }
    if (no_threads) {
        UNLESS(SYS_clone3, 1);
        RETURN(SECCOMP_RET_ERRNO | EAGAIN);
        UNLESS(SYS_clone, 1);
        RETURN(SECCOMP_RET_ERRNO | EAGAIN);
    }
    RETURN(SECCOMP_RET_ALLOW);
    struct sock_fprog program = {n, code};
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) || prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program)) _exit(99);
}

// The clock of the process: a collection spares what is younger than an hour.
int clock_gettime(clockid_t id, struct timespec *now) {
    long result = CALL(clock_gettime, id, (long)now, 0, 0, 0, 0);
    if (id == CLOCK_REALTIME) now->tv_sec += later;
    return result ? -1 : 0;
}

__attribute__((destructor)) static void end(void) {
    char line[64];
    if (report) write_report(line, snprintf(line, sizeof line, "of %ld\n", count));
}

__attribute__((constructor)) static void begin(void) {
    const char *folder = getenv("CRASH_UNDER"), *log = getenv("CRASH_LOG"), *number = getenv("CRASH_AT");
    if (!folder) return;
    snprintf(under, sizeof under, "%s", folder);
    what = getenv("CRASH_WHAT");
    report = getenv("CRASH_REPORT");
    lasts = getenv("CRASH_LASTS") != NULL;
    later = getenv("CRASH_LATER") ? atol(getenv("CRASH_LATER")) : 0;
    at = number ? atol(number) : 0;
    for (size_t i = 0; what && i < sizeof FAULTS / sizeof *FAULTS; i++)
        if (!strcmp(what, FAULTS[i].name)) error = FAULTS[i].error, faults = FAULTS[i].faults;
    int no_threads = what && !strcmp(what, "threads");
    if (what && !faults && !no_threads) _exit(98);
    if (log && (log_fd = open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644)) < 0) _exit(97);
    struct sigaction action = {.sa_sigaction = handle, .sa_flags = SA_SIGINFO};
    if (sigaction(SIGSYS, &action, NULL)) _exit(96);
    install(no_threads);
}
