/* The vendor's functions over a scripted record source, compiled as the vendor's library would be.
 *
 * Written from the vendor's C signatures, not from the driver's: sizes and order of arguments must agree by themselves.
 * The board writes into posted buffers as early as it may and for as long as it may (until the abort), so that memory
 * given back too soon is written to, which the address sanitizer or the processor reports.
 */
#include <stdint.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
/* The vendor's header says unsigned long, which has 32 bits there. */
typedef unsigned long U32;
#else
#define EXPORT __attribute__((visibility("default")))
typedef uint32_t U32;
#endif
typedef uint8_t U8;
typedef uint16_t U16;
typedef uint64_t U64;
typedef void *HANDLE;
typedef enum { Success = 512, Failed = 513, DmaInProgress = 518, NullParam = 531, Unsupported = 533, InvalidSize = 536,
               InvalidAddress = 537, InvalidIndex = 539, InvalidHandle = 572, BufferNotReady = 573, WaitTimeout = 579,
               BufferTooSmall = 581, BufferOverflow = 582, InvalidBuffer = 583, InvalidRecordsPerBuffer = 584 } RC;

enum { MOST_POSTED = 64, MOST_STAMPED = 1000, HEADER_BYTES = 16, HEADERS = 0x8, NPT = 0x200, SERIAL = 460777 };

/* The script: words (record, channel, sample) and trigger times in sample clock periods, owned by the test. */
static const U16 *script_words;
static const U64 *script_stamps;
static U32 script_records, script_channels, script_samples;
static U32 triggers;      /* how many of the scripted records are triggered */
static U32 dual_port, clipped, fpga = 19;
static char failing[64];  /* the call that answers fail_code */
static int fail_code;

static char board;        /* its address is the handle: all 64 bits of it count */
static U32 pre, post, count, busy_polls, running;
static U32 dma_active, mask, per_buffer, flags, announced, filled, waited;
static struct { U8 *memory; U32 bytes; } posted[MOST_POSTED];
static U32 posted_count;

#define REFUSE(name) do { if (!strcmp(failing, #name)) return fail_code; } while (0)
#define BOARD(name) do { REFUSE(name); if (h != (HANDLE)&board) return InvalidHandle; } while (0)

EXPORT void FakeScript(const U16 *words, const U64 *stamps, U32 records, U32 channels, U32 samples)
{
    script_words = words, script_stamps = stamps;
    script_records = triggers = records, script_channels = channels, script_samples = samples;
    dma_active = posted_count = running = 0;
}
EXPORT void FakeOptions(U32 has_dual_port, U32 triggered, U32 clipped_bits, U32 fpga_version)
{
    dual_port = has_dual_port, triggers = triggered, clipped = clipped_bits, fpga = fpga_version;
}
EXPORT void FakeFail(const char *name, int code)
{
    strncpy(failing, name, sizeof failing - 1), fail_code = code;
}
EXPORT U32 FakePosted(void) { return posted_count; }

static U32 channel_count(void) { return (mask & 1) + (mask >> 1 & 1); }
static const U16 *words_of(U32 record, U32 channel)
{
    return script_words + ((U64)record * script_channels + channel) * script_samples;
}
static U32 buffer_bytes(void)
{
    return (2 * script_samples + (flags & HEADERS ? HEADER_BYTES : 0)) * per_buffer * channel_count();
}
static void header(U8 *to, U32 record, U32 channel)
{
    U32 word[4] = {SERIAL & 0x3FFFF, (record & 0xFFFFFF) | 7u << 24, 0, 0};
    word[0] |= channel << 22;
    /* The counter in a header advances once in two sample clock periods. */
    U64 count = script_stamps[record] / 2;
    word[2] = (U32)count;
    /* Everything but the time stamp's high byte belongs to other fields. */
    word[3] = (U32)(count >> 32 & 0xFF) | 0xABCDEF00u;
    memcpy(to, word, HEADER_BYTES);
}
static void fill(U8 *to, U32 first)
{
    U32 channels = channel_count(), size = 2 * script_samples;
    for (U32 i = 0; i < per_buffer * channels; i++) {
        U32 record = first + (flags & NPT ? i % per_buffer : i / channels);
        U32 nth = flags & NPT ? i / per_buffer : i % channels;
        U32 channel = mask == 2 ? 1 : nth;
        if (flags & HEADERS)
            header(to, record, channel), to += HEADER_BYTES;
        memcpy(to, words_of(record, channel), size), to += size;
    }
}
/* Write whatever can be written by now: the buffers after those that wait to be fetched. */
static void advance(void)
{
    while (running && filled - waited < posted_count && (filled + 1) * per_buffer <= triggers)
        fill(posted[filled - waited].memory, filled * per_buffer), filled++;
}

EXPORT HANDLE AlazarGetBoardBySystemID(U32 sid, U32 bid) { return sid == 1 && bid == 1 ? &board : NULL; }
EXPORT U32 AlazarGetBoardKind(HANDLE h) { return h == (HANDLE)&board ? 7 : 0; }
EXPORT RC AlazarGetChannelInfo(HANDLE h, U32 *samples, U8 *bits)
{
    BOARD(AlazarGetChannelInfo);
    *samples = 8388608, *bits = 14;
    return Success;
}
EXPORT RC AlazarGetSDKVersion(U8 *major, U8 *minor, U8 *revision)
{
    *major = 5, *minor = 8, *revision = 2;
    return Success;
}
EXPORT RC AlazarGetDriverVersion(U8 *major, U8 *minor, U8 *revision)
{
    *major = 5, *minor = 6, *revision = 4;
    return Success;
}
EXPORT RC AlazarQueryCapability(HANDLE h, U32 capability, U32 reserved, U32 *value)
{
    BOARD(AlazarQueryCapability);
    (void)reserved;
    switch (capability) {
    case 0x10000024: *value = SERIAL; return Success;
    case 0x1000002C: *value = fpga; return Success;
    case 0x10000037: *value = 2 | (dual_port ? 4 : 0); return Success;
    }
    return Unsupported;
}
EXPORT RC AlazarGetParameter(HANDLE h, U8 channel, U32 parameter, long *value)
{
    BOARD(AlazarGetParameter);
    (void)channel;
    switch (parameter) {
    case 0x10000042: *value = 0; return Success;
    case 0x10000044: *value = 2; return Success;
    case 0x10000045: *value = running ? (long)triggers : 0; return Success;
    case 0x10000050: *value = (long)posted_count; return Success;
    }
    return Unsupported;
}
EXPORT RC AlazarSetCaptureClock(HANDLE h, U32 source, U32 rate, U32 edge, U32 decimation)
{
    BOARD(AlazarSetCaptureClock);
    return source == 1 && rate == 0x24 && edge == 0 && decimation == 0 ? Success : Failed;
}
EXPORT RC AlazarInputControl(HANDLE h, U8 channel, U32 coupling, U32 range, U32 impedance)
{
    BOARD(AlazarInputControl);
    return (channel == 1 || channel == 2) && coupling == 2 && range && range <= 12 && impedance == 2 ? Success : Failed;
}
EXPORT RC AlazarSetBWLimit(HANDLE h, U32 channel, U32 on)
{
    BOARD(AlazarSetBWLimit);
    return channel && on < 2 ? Success : Failed;
}
EXPORT RC AlazarSetTriggerOperation(HANDLE h, U32 op, U32 e1, U32 s1, U32 p1, U32 l1, U32 e2, U32 s2, U32 p2, U32 l2)
{
    BOARD(AlazarSetTriggerOperation);
    return op == 0 && e1 == 0 && s1 == 2 && p1 == 1 && l1 == 166 && e2 == 1 && s2 == 3 && p2 == 1 && l2 == 128
               ? Success : Failed;
}
EXPORT RC AlazarSetExternalTrigger(HANDLE h, U32 coupling, U32 range)
{
    BOARD(AlazarSetExternalTrigger);
    return coupling == 2 && range == 0 ? Success : Failed;
}
EXPORT RC AlazarSetTriggerDelay(HANDLE h, U32 samples)
{
    BOARD(AlazarSetTriggerDelay);
    return samples <= 9999999 ? Success : Failed;
}
EXPORT RC AlazarSetTriggerTimeOut(HANDLE h, U32 ticks)
{
    BOARD(AlazarSetTriggerTimeOut);
    return ticks == 0 ? Success : Failed;
}
EXPORT RC AlazarConfigureAuxIO(HANDLE h, U32 mode, U32 parameter)
{
    BOARD(AlazarConfigureAuxIO);
    return mode == 0 && parameter == 0 ? Success : Failed;
}
EXPORT RC AlazarResetTimeStamp(HANDLE h, U32 option)
{
    BOARD(AlazarResetTimeStamp);
    return option <= 1 ? Success : Failed;
}
EXPORT RC AlazarSetRecordSize(HANDLE h, U32 pre_samples, U32 post_samples)
{
    BOARD(AlazarSetRecordSize);
    pre = pre_samples, post = post_samples;
    return pre + post == script_samples ? Success : InvalidSize;
}
EXPORT RC AlazarSetRecordCount(HANDLE h, U32 n)
{
    BOARD(AlazarSetRecordCount);
    count = n;
    return n && n <= script_records ? Success : InvalidSize;
}
EXPORT RC AlazarGetMaxRecordsCapable(HANDLE h, U32 samples, U32 *most)
{
    BOARD(AlazarGetMaxRecordsCapable);
    *most = 8388608 / (samples + 16);
    return Success;
}
EXPORT RC AlazarStartCapture(HANDLE h)
{
    BOARD(AlazarStartCapture);
    running = 1, busy_polls = 3;
    if (dma_active)
        advance();
    return Success;
}
EXPORT RC AlazarAbortCapture(HANDLE h)
{
    BOARD(AlazarAbortCapture);
    running = 0;
    return Success;
}
EXPORT RC AlazarForceTrigger(HANDLE h)
{
    BOARD(AlazarForceTrigger);
    if (running && triggers < announced)
        triggers++;
    return Success;
}
EXPORT U32 AlazarBusy(HANDLE h)
{
    if (h != (HANDLE)&board || !running || dma_active)
        return h == (HANDLE)&board && running;
    if (triggers >= count && busy_polls && !--busy_polls)
        running = 0;
    return running;
}
EXPORT U32 AlazarGetStatus(HANDLE h) { return h == (HANDLE)&board ? clipped : 0xFFFFFFFF; }
EXPORT U32 AlazarRead(HANDLE h, U32 channel, void *buffer, int element_bytes, long record, long offset, U32 n)
{
    BOARD(AlazarRead);
    if (!buffer)
        return NullParam;
    if (element_bytes != 2 || n != script_samples || offset != -(long)pre || channel - 1 >= script_channels)
        return InvalidSize;
    if (record < 1 || record > (long)triggers)
        return InvalidIndex;
    memcpy(buffer, words_of((U32)record - 1, channel - 1), 2 * (size_t)n);
    /* The vendor may write this much more. */
    memset((U8 *)buffer + 2 * (size_t)n, 0x5A, 2 * 16);
    return Success;
}
EXPORT RC AlazarGetTriggerTimestamp(HANDLE h, U32 record, U64 *stamp)
{
    BOARD(AlazarGetTriggerTimestamp);
    if (record < 1 || record > triggers)
        return InvalidIndex;
    if (record > MOST_STAMPED)
        return 604;
    /* Sample clock periods, not counts of two. */
    *stamp = script_stamps[record - 1];
    return Success;
}
EXPORT RC AlazarBeforeAsyncRead(HANDLE h, U32 channels, long offset, U32 samples, U32 records, U32 total, U32 mode)
{
    BOARD(AlazarBeforeAsyncRead);
    if (dma_active)
        return DmaInProgress;
    if (!dual_port || !(mode & 1) || (mode & ~(1u | HEADERS | NPT)) || ((mode & NPT) && (mode & HEADERS)))
        return Unsupported;
    if (offset != -(long)pre || samples != script_samples)
        return InvalidSize;
    if (!records || total % records)
        return InvalidRecordsPerBuffer;
    mask = channels, per_buffer = records, announced = total, flags = mode;
    dma_active = 1, filled = waited = posted_count = 0;
    return Success;
}
EXPORT RC AlazarPostAsyncBuffer(HANDLE h, void *buffer, U32 bytes)
{
    BOARD(AlazarPostAsyncBuffer);
    if (!buffer)
        return NullParam;
    if (!dma_active || posted_count == MOST_POSTED)
        return Failed;
    if ((uintptr_t)buffer % (flags & NPT ? 64 : 32))
        return InvalidAddress;
    if (bytes < buffer_bytes())
        return BufferTooSmall;
    for (U32 i = 0; i < posted_count; i++)
        if (posted[i].memory == buffer)
            return InvalidBuffer;
    posted[posted_count].memory = buffer, posted[posted_count++].bytes = bytes;
    advance();
    return Success;
}
EXPORT RC AlazarWaitAsyncBufferComplete(HANDLE h, void *buffer, U32 timeout_ms)
{
    BOARD(AlazarWaitAsyncBufferComplete);
    (void)timeout_ms;
    U32 place = 0;
    while (place < posted_count && posted[place].memory != buffer)
        place++;
    if (place == posted_count)
        return BufferNotReady;
    if (place)
        return DmaInProgress;
    advance();
    if (filled == waited)
        return WaitTimeout;
    memmove(posted, posted + 1, --posted_count * sizeof *posted);
    waited++;
    return Success;
}
EXPORT RC AlazarAbortAsyncRead(HANDLE h)
{
    BOARD(AlazarAbortAsyncRead);
    /* Up to here a board may be writing: last words into everything it still holds. */
    for (U32 i = 0; i < posted_count; i++)
        memset(posted[i].memory, 0xEE, posted[i].bytes);
    running = dma_active = posted_count = 0;
    return Success;
}
