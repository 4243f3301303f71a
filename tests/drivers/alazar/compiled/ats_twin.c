/* The vendor's functions, compiled as the vendor's library would be, each carried out by a function connected to it.
 *
 * Written from the vendor's C signatures, not from the driver's: sizes and order of arguments must agree by themselves.
 * A test connects the simulated board's functions, so that a bench file with library = "..." meets a whole bench.
 */
#include <stddef.h>
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
typedef uint64_t U64;
typedef void *HANDLE;
typedef int RC;
enum { InvalidHandle = 572 };

static struct { char name[48]; void (*function)(void); } connected[64];

/* Hand the function called name over to who carries it out; returns 0 where there is no room left. */
EXPORT int TwinConnect(const char *name, void (*function)(void))
{
    for (size_t i = 0; i < sizeof connected / sizeof *connected; i++)
        if (!connected[i].name[0] || !strcmp(connected[i].name, name)) {
            strncpy(connected[i].name, name, sizeof connected[i].name - 1), connected[i].function = function;
            return 1;
        }
    return 0;
}
static void (*carried_out_by(const char *name))(void)
{
    for (size_t i = 0; i < sizeof connected / sizeof *connected && connected[i].name[0]; i++)
        if (!strcmp(connected[i].name, name))
            return connected[i].function;
    return NULL;
}

#define CARRY_OUT(result, absent, name, parameters, arguments) \
    EXPORT result name parameters \
    { \
        result (*function) parameters = (result (*) parameters)carried_out_by(#name); \
        return function ? function arguments : (absent); \
    }
#define CALL(name, parameters, arguments) CARRY_OUT(RC, InvalidHandle, name, parameters, arguments)
#define NUMBER(name, parameters, arguments) CARRY_OUT(U32, 0, name, parameters, arguments)

CARRY_OUT(HANDLE, NULL, AlazarGetBoardBySystemID, (U32 sid, U32 bid), (sid, bid))
NUMBER(AlazarGetBoardKind, (HANDLE h), (h))
CALL(AlazarGetChannelInfo, (HANDLE h, U32 *samples, U8 *bits), (h, samples, bits))
CALL(AlazarGetSDKVersion, (U8 *major, U8 *minor, U8 *revision), (major, minor, revision))
CALL(AlazarGetDriverVersion, (U8 *major, U8 *minor, U8 *revision), (major, minor, revision))
CALL(AlazarQueryCapability, (HANDLE h, U32 capability, U32 reserved, U32 *value), (h, capability, reserved, value))
CALL(AlazarGetParameter, (HANDLE h, U8 channel, U32 parameter, long *value), (h, channel, parameter, value))
CALL(AlazarSetCaptureClock, (HANDLE h, U32 source, U32 rate, U32 edge, U32 decimation),
     (h, source, rate, edge, decimation))
CALL(AlazarInputControl, (HANDLE h, U8 channel, U32 coupling, U32 range, U32 impedance),
     (h, channel, coupling, range, impedance))
CALL(AlazarSetBWLimit, (HANDLE h, U32 channel, U32 on), (h, channel, on))
CALL(AlazarSetTriggerOperation,
     (HANDLE h, U32 op, U32 e1, U32 s1, U32 p1, U32 l1, U32 e2, U32 s2, U32 p2, U32 l2),
     (h, op, e1, s1, p1, l1, e2, s2, p2, l2))
CALL(AlazarSetExternalTrigger, (HANDLE h, U32 coupling, U32 range), (h, coupling, range))
CALL(AlazarSetTriggerDelay, (HANDLE h, U32 samples), (h, samples))
CALL(AlazarSetTriggerTimeOut, (HANDLE h, U32 ticks), (h, ticks))
CALL(AlazarConfigureAuxIO, (HANDLE h, U32 mode, U32 parameter), (h, mode, parameter))
CALL(AlazarResetTimeStamp, (HANDLE h, U32 option), (h, option))
CALL(AlazarSetRecordSize, (HANDLE h, U32 pre, U32 post), (h, pre, post))
CALL(AlazarSetRecordCount, (HANDLE h, U32 count), (h, count))
CALL(AlazarGetMaxRecordsCapable, (HANDLE h, U32 samples, U32 *most), (h, samples, most))
CALL(AlazarStartCapture, (HANDLE h), (h))
CALL(AlazarAbortCapture, (HANDLE h), (h))
CALL(AlazarForceTrigger, (HANDLE h), (h))
NUMBER(AlazarBusy, (HANDLE h), (h))
NUMBER(AlazarGetStatus, (HANDLE h), (h))
NUMBER(AlazarRead, (HANDLE h, U32 channel, void *buffer, int bytes, long record, long offset, U32 count),
       (h, channel, buffer, bytes, record, offset, count))
CALL(AlazarGetTriggerTimestamp, (HANDLE h, U32 record, U64 *stamp), (h, record, stamp))
CALL(AlazarBeforeAsyncRead, (HANDLE h, U32 channels, long offset, U32 samples, U32 records, U32 total, U32 mode),
     (h, channels, offset, samples, records, total, mode))
CALL(AlazarPostAsyncBuffer, (HANDLE h, void *buffer, U32 bytes), (h, buffer, bytes))
CALL(AlazarWaitAsyncBufferComplete, (HANDLE h, void *buffer, U32 timeout_ms), (h, buffer, timeout_ms))
CALL(AlazarAbortAsyncRead, (HANDLE h), (h))
