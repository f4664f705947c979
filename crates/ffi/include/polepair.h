/* libpolepair: the C interface of Polepair. Generated from crates/ffi by `cargo xtask codegen`; never edited.
 *
 * Handles: opaque. Each may be used by any thread; calls on one handle from several threads run at the same time.
 *     The error that a handle keeps is that of its last failed call: threads that want their own use handles of
 *     their own (pp_link_axis gives a new one each time).
 * Results: functions return a pp_status; results go through pointers. A failed call leaves them alone.
 * Text: UTF-8 with its length in bytes; PP_NTS as length means that it ends at its first zero byte.
 * Structs: begin with their size, which the caller sets: struct.size = sizeof struct. A program that was built with
 *     an older header gets the fields that it knows.
 * Units: SI (rad, rad/s, N m, A, V, s), unless a function says otherwise.
 * Motion: an axis moves only after pp_axis_arm. pp_link_close stops, disables and disarms what was armed.
 * Forks: a child process is refused (PP_FORKED).
 * Linkage: extern "C", cdecl. */

#ifndef POLEPAIR_H
#define POLEPAIR_H

#include <stddef.h>
#include <stdint.h>

/* Length of a text that ends at its first zero byte. */
#define PP_NTS ((size_t)-1)


/**
 * Version of the binary interface that this header describes. It changes only if a program that was built with
 * an older header would no longer work.
 */
#define PP_ABI_VERSION 0

/**
 * One axis of a link: a motor. Several handles may stand for the same axis.
 */
typedef struct pp_axis pp_axis;

/**
 * A link: a serial port, a CAN bus, a simulation, or the axes of a running server.
 */
typedef struct pp_link pp_link;

/**
 * A request that was begun.
 */
typedef struct pp_request pp_request;

/**
 * Result of a scan.
 */
typedef struct pp_scan pp_scan;

/**
 * A trace of an axis.
 */
typedef struct pp_trace pp_trace;

/**
 * Result of a call: `PP_OK`, or one of the other `PP_` codes. Codes below 64 are the exit codes of the command line
 * (docs/reference/exit-codes.md).
 */
typedef int32_t pp_status;

/**
 * An error, as `pp_link_error` and its siblings copy it. Texts end with a zero byte; one that is too long is cut.
 */
typedef struct pp_error {
    /**
     * Size of this struct, set by the caller: `sizeof(pp_error)`.
     */
    uint32_t size;
    /**
     * Status that the failed call returned.
     */
    pp_status status;
    /**
     * True if the drive executed the request: 1 yes, 0 no, -1 unknown, or in part.
     */
    int32_t executed;
    /**
     * 1 if the motor may still turn, and only cutting its supply stops it.
     */
    int32_t may_turn;
    /**
     * Stable code: "E401" (docs/reference/exit-codes.md).
     */
    char code[32];
    /**
     * Description of the error, in a sentence without full stop.
     */
    char message[1024];
    /**
     * Remedy to try. May be empty.
     */
    char hint[512];
} pp_error;

/**
 * Description of an axis. Texts end with a zero byte.
 */
typedef struct pp_axis_info {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * The drive's address on the wire.
     */
    uint32_t number;
    /**
     * 0 rotary (rad), 1 linear (m), 2 a share of full scale (-1 to 1).
     */
    uint32_t kind;
    /**
     * 1 if the drive is simulated.
     */
    uint32_t is_simulated;
    /**
     * Name in a rack file. May be empty.
     */
    char name[64];
    /**
     * "axis 1", or "axis 1 (x)" if it has a name.
     */
    char label[64];
    /**
     * The protocol's word: "tmcl".
     */
    char protocol[32];
    /**
     * The profile's word: "tmcm-170".
     */
    char profile[64];
    /**
     * The product's full name.
     */
    char title[128];
    /**
     * Checks before the first motion. May be empty.
     */
    char caution[512];
    /**
     * Reaction of the drive when its host falls silent.
     */
    char watchdog[256];
} pp_axis_info;

/**
 * An active fault or warning.
 */
typedef struct pp_fault {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * The drive's code.
     */
    uint32_t code;
    /**
     * 1 if the drive continues.
     */
    uint32_t is_warning;
    /**
     * 0.
     */
    uint32_t reserved;
    /**
     * The manual's short name.
     */
    char name[64];
    /**
     * Name of the fault in words.
     */
    char text[128];
    /**
     * Usual cause of the fault.
     */
    char cause[256];
    /**
     * Remedy of the fault.
     */
    char remedy[256];
} pp_fault;

/**
 * Function that a recording calls once.
 */
typedef void (*pp_started)(void *context);

/**
 * A recording in a drive's own memory. Set all fields by `pp_drive_log_init`.
 */
typedef struct pp_drive_log {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * 1 to accept a layout of the drive's buffer that no public source states.
     */
    int32_t inferred;
    /**
     * Points a second: 1000 and its parts, up to 10000, on a TML drive.
     */
    double rate;
    /**
     * Length of the recording: s.
     */
    double seconds;
    /**
     * Condition of the start, such as "APOS > 1turn", with a zero byte behind it. NULL starts at once.
     */
    const char *on;
    /**
     * Called when the recording runs, or while `on` is waited for: it may start a motion of this axis. May be NULL.
     */
    pp_started started;
    /**
     * Argument of `started`.
     */
    void *context;
    /**
     * First address of the drive's memory that nothing else uses; 0 for the memory that every such drive has.
     */
    uint32_t first_address;
    /**
     * Last address of that memory.
     */
    uint32_t last_address;
} pp_drive_log;

/**
 * Kind of an event.
 */
typedef int32_t pp_event_kind;

/**
 * A signal. Values are SI: rad, rad/s, N·m (or what the drive has in its place), A, V, K; m and m/s on a linear
 * axis. Flags are 0 or 1; codes and modes are the drive's own numbers.
 */
typedef int32_t pp_signal;

/**
 * One thing that happened.
 */
typedef struct pp_event {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * Kind of the event: `PP_EVENT_` and a name.
     */
    pp_event_kind kind;
    /**
     * The number of the axis; 0 for what happened to the link.
     */
    uint32_t axis;
    /**
     * The signal of `PP_EVENT_SIGNAL`; -1 otherwise.
     */
    pp_signal signal;
    /**
     * The code of a fault; 0 otherwise.
     */
    uint32_t code;
    /**
     * 0.
     */
    uint32_t reserved;
    /**
     * Seconds on the link's clock.
     */
    double time;
    /**
     * The value of a signal (SI) or a parameter (in its unit); NaN otherwise.
     */
    double value;
    /**
     * The event in words: "axis 1: armed".
     */
    char text[256];
} pp_event;

/**
 * A function that is called for each event. `event` is valid during the call.
 */
typedef void (*pp_event_handler)(const struct pp_event *event, void *user);

/**
 * Limits of a motion. NaN means the drive's own value: set all fields by `pp_motion_init`.
 */
typedef struct pp_motion {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * 0.
     */
    uint32_t reserved;
    /**
     * Greatest speed on the way: rad/s or m/s.
     */
    double velocity;
    /**
     * rad/s² or m/s².
     */
    double acceleration;
    /**
     * rad/s² or m/s².
     */
    double deceleration;
    /**
     * Torque limit: N·m, or what the drive has in its place.
     */
    double torque;
    /**
     * Time in which the acceleration of an S-curve builds up: s.
     */
    double jerk_time;
} pp_motion;

/**
 * A command to a drive, for `pp_axis_run` and `pp_axis_begin`.
 */
typedef int32_t pp_verb;

/**
 * A parameter, without its value. Texts end with a zero byte.
 */
typedef struct pp_parameter {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * 1 if it can be read.
     */
    uint32_t readable;
    /**
     * 1 if it can be written.
     */
    uint32_t writable;
    /**
     * 1 if writing it may move the motor.
     */
    uint32_t moves;
    /**
     * Least raw value.
     */
    int64_t raw_min;
    /**
     * Greatest raw value.
     */
    int64_t raw_max;
    /**
     * The name that users type.
     */
    char name[128];
    /**
     * Designation in the manual: "AP 6".
     */
    char symbol[64];
    /**
     * Symbol of its unit. May be empty.
     */
    char unit[32];
    /**
     * "number", "text" or "bytes".
     */
    char kind[16];
    /**
     * Persistence of a written value: "volatile", "storable", "always", "unless-ram".
     */
    char persistence[32];
    /**
     * Description. May be empty.
     */
    char about[512];
} pp_parameter;

/**
 * A drive that a scan has found. Texts end with a zero byte.
 */
typedef struct pp_found {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * Address on the wire.
     */
    uint32_t number;
    /**
     * The profile's word: "tmcm-170".
     */
    char profile[64];
    /**
     * The product's full name.
     */
    char title[128];
    /**
     * Identity that the drive reports. May be empty.
     */
    char identity[256];
    /**
     * Conflict of its address: two drives share it. May be empty.
     */
    char clash[256];
} pp_found;

/**
 * The last known state of an axis. -1 means unknown.
 */
typedef struct pp_state {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * 1 if the motor has power.
     */
    int32_t enabled;
    /**
     * 1 if the motor moves.
     */
    int32_t moving;
    /**
     * 1 if this program armed the axis.
     */
    int32_t armed;
    /**
     * Mode of operation in words. May be empty.
     */
    char mode[64];
    /**
     * The client with the lease, on a server. May be empty.
     */
    char owner[64];
} pp_state;

/**
 * True state of a simulated motor, independent of the reports of its drive.
 */
typedef struct pp_truth {
    /**
     * Size of this struct, set by the caller.
     */
    uint32_t size;
    /**
     * 1 if the power stage is on.
     */
    uint32_t enabled;
    /**
     * The drive's fault code or bits; 0 for none.
     */
    uint32_t fault;
    /**
     * 0.
     */
    uint32_t reserved;
    /**
     * Writes to permanent memory since power-on.
     */
    uint64_t flash_writes;
    /**
     * Shaft position since power-on: rad.
     */
    double position;
    /**
     * Shaft speed: rad/s.
     */
    double velocity;
    /**
     * Motor current: A.
     */
    double current;
    /**
     * Torque: N·m.
     */
    double torque;
    /**
     * Temperature of the winding: °C.
     */
    double winding;
} pp_truth;

/**
 * The call is done.
 */
#define PP_OK 0

/**
 * The answer is no, or the drive did not keep what was written.
 */
#define PP_NEGATIVE 1

/**
 * The caller's words or values are wrong. Nothing was sent.
 */
#define PP_USAGE 2

/**
 * The adapter or the port: missing, in use, unplugged.
 */
#define PP_ADAPTER 3

/**
 * The drive does not reply.
 */
#define PP_NO_REPLY 4

/**
 * Replies are damaged or contradict each other.
 */
#define PP_CORRUPT 5

/**
 * The drive refused the request.
 */
#define PP_REFUSED 6

/**
 * A part was done.
 */
#define PP_PARTIAL 7

/**
 * The drive has a fault.
 */
#define PP_DRIVE_FAULT 8

/**
 * The drive reports that it is done, and nothing that it reports shows it.
 */
#define PP_UNCONFIRMED 9

/**
 * The request has not ended yet.
 */
#define PP_PENDING 64

/**
 * There is nothing to return: no event, no sample, no error.
 */
#define PP_NOTHING 65

/**
 * The caller's buffer is too small. The length that it needs is returned.
 */
#define PP_BUFFER 66

/**
 * The process is a child of the one that opened the link. Nothing was done.
 */
#define PP_FORKED 67

/**
 * A defect in the library. The motor may be in any state: stop it by other means.
 */
#define PP_DEFECT 68

/**
 * The wait was interrupted.
 */
#define PP_INTERRUPTED 130

/**
 * The drive sent the value of a signal.
 */
#define PP_EVENT_SIGNAL 0

/**
 * The drive sent the value of a parameter that is no signal.
 */
#define PP_EVENT_PARAMETER 1

/**
 * The drive now has a fault.
 */
#define PP_EVENT_FAULT 2

/**
 * A fault has gone.
 */
#define PP_EVENT_FAULT_CLEARED 3

/**
 * The drive changed its state in the network: it restarted, or is gone.
 */
#define PP_EVENT_PRESENCE 4

/**
 * The axis was armed.
 */
#define PP_EVENT_ARMED 5

/**
 * The axis was disarmed.
 */
#define PP_EVENT_DISARMED 6

/**
 * The link was lost. It is tried again.
 */
#define PP_EVENT_LINK_LOST 7

/**
 * The link is there again.
 */
#define PP_EVENT_LINK_BACK 8

/**
 * An event that this version of the header does not know: its text describes it.
 */
#define PP_EVENT_OTHER 99

/**
 * Powers the motor; it holds its actual position.
 */
#define PP_ENABLE 0

/**
 * Removes power from the motor.
 */
#define PP_DISABLE 1

/**
 * Clears faults.
 */
#define PP_CLEAR 2

/**
 * Turns at `target`: rad/s, m/s, or a share.
 */
#define PP_VELOCITY 3

/**
 * Turns with the torque `target`: N·m, or what the drive has in its place (A, a share).
 */
#define PP_TORQUE 4

/**
 * Moves to the position `target`: rad or m.
 */
#define PP_MOVE_TO 5

/**
 * Moves by the distance `target` from the actual position. Never sent twice.
 */
#define PP_MOVE_BY 6

/**
 * Moves by the distance `target` from the last target. Never sent twice.
 */
#define PP_MOVE_ON 7

/**
 * Moves to `target` with an S-curve.
 */
#define PP_CURVE_TO 8

/**
 * Moves by `target` with an S-curve. Never sent twice.
 */
#define PP_CURVE_BY 9

/**
 * Finds the drive's reference, and ends with it.
 */
#define PP_HOME 10

/**
 * Saves the settings in the drive's permanent memory.
 */
#define PP_STORE 11

/**
 * Position: rad or m.
 */
#define PP_SIGNAL_POSITION 0

/**
 * Velocity: rad/s or m/s.
 */
#define PP_SIGNAL_VELOCITY 1

/**
 * Torque.
 */
#define PP_SIGNAL_TORQUE 2

/**
 * Motor current: A.
 */
#define PP_SIGNAL_CURRENT 3

/**
 * Supply voltage: V.
 */
#define PP_SIGNAL_VOLTAGE 4

/**
 * Temperature: K.
 */
#define PP_SIGNAL_TEMPERATURE 5

/**
 * Target position.
 */
#define PP_SIGNAL_TARGET_POSITION 6

/**
 * Target velocity.
 */
#define PP_SIGNAL_TARGET_VELOCITY 7

/**
 * Fault code or fault word.
 */
#define PP_SIGNAL_FAULT 8

/**
 * The motor has power.
 */
#define PP_SIGNAL_ENABLED 9

/**
 * The motor moves.
 */
#define PP_SIGNAL_MOVING 10

/**
 * The target is reached.
 */
#define PP_SIGNAL_REACHED 11

/**
 * Mode of operation.
 */
#define PP_SIGNAL_MODE 12

/**
 * Time of the drive: s.
 */
#define PP_SIGNAL_TIME 13

/**
 * A limit holds the motor at the positive end.
 */
#define PP_SIGNAL_POSITIVE_LIMIT 14

/**
 * A limit holds the motor at the negative end. Both are 1 if the drive does not report which end it is.
 */
#define PP_SIGNAL_NEGATIVE_LIMIT 15

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * Opens a handle for the axis at this place of a link, from 0 on.
 *
 * Close it by `pp_axis_close`. Nothing is sent. PP_USAGE if there is no such axis.
 *
 * Pointers: `link` is NULL or valid; `axis` is valid.
 */
pp_status pp_link_axis_at(const struct pp_link *link, size_t index, struct pp_axis **axis);

/**
 * Opens a handle for an axis by its number or name: "1", "x", "1.2" for motor 2 of module 1.
 *
 * Pointers: `link` is NULL or valid; `name` has `length` bytes; `axis` is valid.
 */
pp_status pp_link_axis(const struct pp_link *link, const char *name, size_t length, struct pp_axis **axis);

/**
 * Closes a handle of an axis. The motor is left as it is: `pp_axis_release` or `pp_link_close` stops it.
 *
 * Pointers: `axis` is NULL or a handle that no other thread uses.
 */
void pp_axis_close(struct pp_axis *axis);

/**
 * Copies the last error of an axis handle. PP_NOTHING if no call has failed.
 *
 * Pointers: `axis` and `error` are NULL or valid.
 */
pp_status pp_axis_error(const struct pp_axis *axis, struct pp_error *error);

/**
 * Copies the last error of an axis handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
 * if no call has failed. As `pp_link_url` for the buffer.
 *
 * Pointers: `axis` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_axis_error_text(const struct pp_axis *axis,
                             char *buffer,
                             size_t capacity,
                             size_t *needed);

/**
 * Limits how long calls on this handle wait for a drive. A call that reaches it returns PP_PENDING, and its
 * request continues: the drive may still execute it. 0 or less for no limit, which is so at first: requests end
 * by themselves after the time-outs of their protocol. Stopping is not limited.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_set_time_limit(const struct pp_axis *axis,
                                 double seconds);

/**
 * Describes an axis. Nothing is sent.
 *
 * Example:
 *     pp_axis_info info = { .size = sizeof info };
 *     pp_axis_get_info(axis, &info);
 *     puts(info.title);
 *
 * Pointers: `axis` is NULL or valid; `info` is valid.
 */
pp_status pp_axis_get_info(const struct pp_axis *axis, struct pp_axis_info *info);

/**
 * Reads the device information, a line each: "firmware: 1.42". As `pp_link_url` for the buffer.
 *
 * Pointers: `axis` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_axis_device(const struct pp_axis *axis, char *buffer, size_t capacity, size_t *needed);

/**
 * Arms an axis: motion commands of this program are allowed. On a server this acquires the lease. Nothing moves.
 * PP_USAGE with E220 if it is armed already.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_arm(const struct pp_axis *axis);

/**
 * Stops, disables and disarms an axis that this program armed. A stop without a reply is repeated for ten
 * seconds. If `may_turn` of the error is 1, cut the supply.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_release(const struct pp_axis *axis);

/**
 * Disarms an axis, and leaves the motor as it is. A server stops a motion when the lease ends.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_disarm(const struct pp_axis *axis);

/**
 * Reports whether this program armed the axis: 1 or 0.
 *
 * Pointers: `axis` is NULL or valid; `armed` is valid.
 */
pp_status pp_axis_is_armed(const struct pp_axis *axis, int32_t *armed);

/**
 * Stops the motor, armed or not, and returns when standstill is confirmed. Thread-safe: a stop overtakes
 * requests of other threads. If `may_turn` of the error is 1, cut the supply.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_stop(const struct pp_axis *axis);

/**
 * Reads which faults are active. `*count` gets their number; the fault at `index` is copied to `fault`, which may
 * be NULL to ask for the number alone. PP_OK as well if there is none, and `fault` is left alone.
 *
 * Pointers: `axis` is NULL or valid; `fault` is NULL or valid; `count` is valid.
 */
pp_status pp_axis_fault(const struct pp_axis *axis,
                        size_t index,
                        struct pp_fault *fault,
                        size_t *count);

/**
 * Reads the drive's watchdog: seconds without a message of its host after which it stops, NaN for none.
 *
 * Pointers: `axis` is NULL or valid; `seconds` is valid.
 */
pp_status pp_axis_watchdog(const struct pp_axis *axis, double *seconds);

/**
 * Sets the drive's watchdog; 0 switches it off. PP_USAGE for a drive without one that can be set.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_set_watchdog(const struct pp_axis *axis, double seconds);

/**
 * Lets an axis follow another one of its bus by a ratio, in the drives: `turns` of its motor to `master_turns` of the
 * master's. A negative number turns the other way.
 *
 * The axis must be armed and powered, and the master at rest. Nothing moves until the master does. PP_NEGATIVE with
 * E101 if the drive does not receive the master's position: it was not coupled. PP_USAGE with E217 or E245 for what
 * cannot be coupled. The axis follows until `pp_axis_uncouple`, a stop, or another motion of it. Thread-safe.
 *
 * Example:
 *     pp_axis_follow_gear(follower, master, 1, 3);
 *     pp_axis_run(master, PP_MOVE_TO, 6.2832, NULL);
 *
 * Pointers: `axis` and `master` are NULL or valid.
 */
pp_status pp_axis_follow_gear(const struct pp_axis *axis,
                              const struct pp_axis *master,
                              int32_t turns,
                              int32_t master_turns);

/**
 * Lets an axis follow another one of its bus by a cam's table, in the drives. As `pp_axis_follow_gear`.
 *
 * `points` has `count` pairs in rad, the master's positions ascending: master, follower. The table lies in the
 * drive's memory from `first_address` to `last_address`, which nothing else uses; both 0 for the memory that every
 * such drive has. Its layout is inferred: PP_USAGE with E222 unless `inferred` is 1.
 *
 * Pointers: `axis` and `master` are NULL or valid; `points` has twice `count` elements.
 */
pp_status pp_axis_follow_cam(const struct pp_axis *axis,
                             const struct pp_axis *master,
                             const double *points,
                             size_t count,
                             uint32_t first_address,
                             uint32_t last_address,
                             int32_t inferred);

/**
 * Ends the coupling of an axis: stops it, and the messages of the master, which must be at rest.
 *
 * Pointers: `axis` and `master` are NULL or valid.
 */
pp_status pp_axis_uncouple(const struct pp_axis *axis, const struct pp_axis *master);

/**
 * Sets a recording to 0.2 s with 1000 points a second, at once, in the memory that every such drive has. `size`
 * must be set before.
 *
 * Pointers: `log` is NULL or valid.
 */
void pp_drive_log_init(struct pp_drive_log *log);

/**
 * Records variables in the drive's own control loop, all of a point at one instant, and reads them. Blocks until
 * the points are read. TML drives have such a recorder; nothing moves, except by `started`.
 *
 * `variables` are names with commas in between. `*trace` gets the rows for `pp_trace_read`, a value for each
 * variable in SI, until PP_NOTHING. PP_USAGE with E222 if the drive's layout is inferred and `inferred` is 0, with
 * E216 for what does not fit: nothing was sent. `log` may be NULL. Close the trace by `pp_trace_close`.
 *
 * Example:
 *     pp_drive_log log = { sizeof log };
 *     pp_drive_log_init(&log);
 *     log.inferred = 1;
 *     pp_trace *trace;
 *     double time, row[2];
 *     if (pp_axis_record_in_drive(axis, "POSERR,APOS", PP_NTS, &log, &trace) == PP_OK)
 *         while (pp_trace_read(trace, 0, &time, row) == PP_OK)
 *             printf("%g %g %g\n", time, row[0], row[1]);
 *
 * Pointers: `axis` is NULL or valid; `variables` has `length` bytes; `log` is NULL or valid; `trace` is valid.
 */
pp_status pp_axis_record_in_drive(const struct pp_axis *axis,
                                  const char *variables,
                                  size_t length,
                                  const struct pp_drive_log *log,
                                  struct pp_trace **trace);

/**
 * Begins to listen: events from now on wait for `pp_link_next_event`, at most 8192; then the oldest go. PP_USAGE
 * with E257 on a server, and if the link listens already.
 *
 * Pointers: `link` is NULL or valid.
 */
pp_status pp_link_listen(const struct pp_link *link);

/**
 * Begins to listen, and has `handler` called for each event from now on, with `user`.
 *
 * All calls come from one thread that the library starts for this link; nothing is called after `pp_link_close`
 * has returned. The handler may call any function but `pp_link_close` of this link, and must not throw.
 *
 * Pointers: `link` is NULL or valid; `handler` may be called from another thread with `user`.
 */
pp_status pp_link_set_event_handler(const struct pp_link *link,
                                    pp_event_handler handler,
                                    void *user);

/**
 * Returns the next event. Waits for it at most `seconds`, then returns PP_NOTHING.
 *
 * Pointers: `link` is NULL or valid; `event` is valid.
 */
pp_status pp_link_next_event(const struct pp_link *link, double seconds, struct pp_event *event);

/**
 * Gives the number of events that were lost because they were not fetched in time.
 *
 * Pointers: `link` is NULL or valid; `count` is valid.
 */
pp_status pp_link_lost_events(const struct pp_link *link, uint64_t *count);

/**
 * Opens a link by its connection string, and finds out which drives are there.
 *
 * `url` is as on the command line: "tmcl+serial:///dev/ttyUSB0#1", "tml+serial://COM3#1", "sim:tmcl",
 * "ws://host:7365" (docs/reference/connection-strings.md). `*link` is set even if the link
 * cannot be opened: the handle then keeps the error, and must be closed. It is NULL only in a child process after
 * `fork`. Nothing moves.
 *
 * Returns PP_OK; PP_USAGE for a wrong connection string; PP_ADAPTER for a port that is missing or in use;
 * PP_NO_REPLY if a drive does not reply. Blocks until the drives have replied. Thread-safe.
 *
 * Example:
 *     pp_link *link;
 *     if (pp_link_open("sim:tmcl", PP_NTS, &link) != PP_OK) {
 *         pp_error error = { .size = sizeof error };
 *         pp_link_error(link, &error);
 *         fprintf(stderr, "%s. %s\n", error.message, error.hint);
 *     }
 *
 * Pointers: `url` has `length` bytes; `link` is valid.
 */
pp_status pp_link_open(const char *url,
                       size_t length,
                       struct pp_link **link);

/**
 * Closes a link: stops, disables and disarms every axis that this program armed by it, then closes the wire.
 *
 * All stops are sent before the first is waited for; a stop without a reply is repeated for ten seconds.
 * `error` may be NULL; if an axis could not be stopped, it gets the error. The handle is invalid afterwards,
 * whatever is returned. Handles of its axes stay valid until they are closed, and refuse to work. `link` may be
 * NULL. Must not be called from an event handler of the same link.
 *
 * Pointers: `link` is NULL or a handle that no other thread uses; `error` is NULL or valid.
 */
pp_status pp_link_close(struct pp_link *link,
                        struct pp_error *error);

/**
 * Copies the last error of a link. PP_NOTHING if no call has failed.
 *
 * Pointers: `link` and `error` are NULL or valid.
 */
pp_status pp_link_error(const struct pp_link *link, struct pp_error *error);

/**
 * Copies the last error of a link handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
 * if no call has failed. As `pp_link_url` for the buffer.
 *
 * Pointers: `link` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_link_error_text(const struct pp_link *link,
                             char *buffer,
                             size_t capacity,
                             size_t *needed);

/**
 * The number of axes of a link.
 *
 * Pointers: `link` is NULL or valid; `count` is valid.
 */
pp_status pp_link_axis_count(const struct pp_link *link, size_t *count);

/**
 * Copies the connection string of a link, with a zero byte behind it.
 *
 * `*needed` gets its length in bytes without the zero byte; `buffer` may be NULL to ask for it. PP_BUFFER if
 * `capacity` is too small.
 *
 * Pointers: `link` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_link_url(const struct pp_link *link, char *buffer, size_t capacity, size_t *needed);

/**
 * Stops every axis of a link, armed by this program or not, and returns when standstill is confirmed.
 *
 * All stops are sent before the first is waited for. On a server, axes are stopped also while other clients command
 * them. If `may_turn` of the error is 1, cut the supply. Thread-safe: a stop overtakes requests of other threads.
 *
 * Pointers: `link` is NULL or valid.
 */
pp_status pp_link_stop_all(const struct pp_link *link);

/**
 * Waits on the clock of a link: in a simulation with `time=virtual`, time passes at once.
 *
 * Pointers: `link` is NULL or valid.
 */
pp_status pp_link_sleep(const struct pp_link *link, double seconds);

/**
 * Sets the limits of a motion to what the drive has. `size` must be set before.
 *
 * Pointers: `motion` is NULL or valid.
 */
void pp_motion_init(struct pp_motion *motion);

/**
 * Runs a verb, and returns when the drive has acknowledged it; homing returns when it has ended.
 *
 * `target` is SI, and ignored by verbs without one. `limits` may be NULL. The axis must be armed for what moves:
 * PP_USAGE with E219. PP_USAGE with E218 for a verb or an argument that the drive does not have, and with E216
 * outside of its limits: nothing was sent. Thread-safe.
 *
 * Example:
 *     pp_axis_run(axis, PP_MOVE_TO, 1.5708, NULL);
 *     pp_axis_wait(axis, 10.0);
 *
 * Pointers: `axis` and `limits` are NULL or valid.
 */
pp_status pp_axis_run(const struct pp_axis *axis,
                      pp_verb verb,
                      double target,
                      const struct pp_motion *limits);

/**
 * Runs a verb with its target as text with a unit: "90 deg", "60 rpm". As `pp_axis_run`.
 *
 * Pointers: As `pp_axis_run`; `target` has `length` bytes.
 */
pp_status pp_axis_run_text(const struct pp_axis *axis,
                           pp_verb verb,
                           const char *target,
                           size_t length,
                           const struct pp_motion *limits);

/**
 * Powers the motor of an armed axis; it holds its actual position. A drive without a switch for its power:
 * PP_USAGE with E218.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_enable(const struct pp_axis *axis);

/**
 * Removes power from the motor.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_disable(const struct pp_axis *axis);

/**
 * Clears faults.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_clear(const struct pp_axis *axis);

/**
 * rad/s (m/s, a share): turns an armed axis at a speed. The motor turns until it is stopped.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_velocity(const struct pp_axis *axis, double speed);

/**
 * Turns an armed axis at a speed as text: "60 rpm".
 *
 * Pointers: `axis` is NULL or valid; `speed` has `length` bytes.
 */
pp_status pp_axis_velocity_text(const struct pp_axis *axis, const char *speed, size_t length);

/**
 * rad (m on a linear axis): starts a move of an armed axis to a position. `pp_axis_wait` waits for its end.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_move_to(const struct pp_axis *axis, double position);

/**
 * Starts a move of an armed axis to a position as text: "90 deg".
 *
 * Pointers: `axis` is NULL or valid; `position` has `length` bytes.
 */
pp_status pp_axis_move_to_text(const struct pp_axis *axis, const char *position, size_t length);

/**
 * rad (m on a linear axis): starts a move of an armed axis by a distance from its actual position. It is never
 * sent twice.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_move_by(const struct pp_axis *axis,
                          double distance);

/**
 * Starts a move of an armed axis by a distance as text: "-1 turn".
 *
 * Pointers: `axis` is NULL or valid; `distance` has `length` bytes.
 */
pp_status pp_axis_move_by_text(const struct pp_axis *axis, const char *distance, size_t length);

/**
 * Finds the reference of an armed axis, and returns when it is found.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_home(const struct pp_axis *axis);

/**
 * Waits until a move has reached its target, at most `seconds`. The motor is not stopped at that time: PP_NEGATIVE,
 * with E101. If it ended elsewhere, PP_NEGATIVE with E106 or E102. PP_DRIVE_FAULT if a fault ends the move,
 * PP_UNCONFIRMED if the drive reports no position.
 *
 * Pointers: `axis` is NULL or valid.
 */
pp_status pp_axis_wait(const struct pp_axis *axis,
                       double seconds);

/**
 * Reads a number in the unit of its parameter: "max current" in A, for example.
 *
 * `name` is a name, the manual's symbol, or an address in the protocol's notation: "max current", "AP 6",
 * "0x6041", "R 51" (docs/reference/addresses.md). `*value` is NaN while its scale is not known. PP_USAGE for a
 * name that the drive does not have, with the nearest one as hint, and for text and bytes. Blocks until the
 * drive has replied. Thread-safe.
 *
 * Example:
 *     double current;
 *     if (pp_axis_get(axis, "max current", PP_NTS, &current) == PP_OK)
 *         printf("%g A\n", current);
 *
 * Pointers: `axis` is NULL or valid; `name` has `length` bytes; `value` is valid.
 */
pp_status pp_axis_get(const struct pp_axis *axis,
                      const char *name,
                      size_t length,
                      double *value);

/**
 * Reads the raw value of a parameter, as it is on the wire. As `pp_axis_get`.
 *
 * Pointers: As `pp_axis_get`.
 */
pp_status pp_axis_get_raw(const struct pp_axis *axis, const char *name, size_t length, int64_t *value);

/**
 * Reads a parameter of any kind as people read it: "1.2 A", "on", text, or bytes in hexadecimal.
 *
 * Reads a parameter as text: the name as in `pp_axis_get`, the buffer as in `pp_link_url`. With PP_BUFFER the
 * parameter was read, and is read again by the next call.
 *
 * Pointers: As `pp_axis_get`; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_axis_get_text(const struct pp_axis *axis,
                           const char *name,
                           size_t length,
                           char *buffer,
                           size_t capacity,
                           size_t *needed);

/**
 * Reads all bytes of a parameter that holds text or bytes, without its final zeros if it is text.
 *
 * Pointers: As `pp_axis_get_text`.
 */
pp_status pp_axis_get_bytes(const struct pp_axis *axis,
                            const char *name,
                            size_t length,
                            uint8_t *buffer,
                            size_t capacity,
                            size_t *needed);

/**
 * Writes a number in the unit of its parameter. It is not stored in permanent memory.
 *
 * Behind the maker's symbol ("AP 6", "CSPD", "0x6083") a number could also be meant as the drive's own: PP_USAGE with
 * E217 where the two differ. Use the parameter's name, `pp_axis_set_raw` or `pp_axis_set_text`.
 *
 * Limits are checked before a byte is sent: PP_USAGE with E216 outside of them, and with E219 for a parameter that
 * may move the motor of an axis that is not armed. Blocks until the drive has acknowledged it. Thread-safe.
 *
 * Pointers: `axis` is NULL or valid; `name` has `length` bytes.
 */
pp_status pp_axis_set(const struct pp_axis *axis,
                      const char *name,
                      size_t length,
                      double value);

/**
 * Writes a raw value, as it is on the wire. As `pp_axis_set`; with `store` other than 0 the drive also keeps it
 * in its permanent memory.
 *
 * Pointers: As `pp_axis_set`.
 */
pp_status pp_axis_set_raw(const struct pp_axis *axis,
                          const char *name,
                          size_t length,
                          int64_t value,
                          int32_t store);

/**
 * Writes a value with its unit, or one of the parameter's words: "1200 mA", "on". As `pp_axis_set_raw`. Without a unit
 * it is in the parameter's unit, and behind the maker's symbol ("AP 6", "CSPD", "0x6083") the drive's own number.
 *
 * Pointers: As `pp_axis_set`; `value` has `value_length` bytes.
 */
pp_status pp_axis_set_text(const struct pp_axis *axis,
                           const char *name,
                           size_t length,
                           const char *value,
                           size_t value_length,
                           int32_t store);

/**
 * Writes all bytes of a parameter that holds text or bytes. PP_USAGE with E257 on a server.
 *
 * Pointers: `axis` is NULL or valid; `name` has `length` bytes; `bytes` has `count` bytes.
 */
pp_status pp_axis_set_bytes(const struct pp_axis *axis,
                            const char *name,
                            size_t length,
                            const uint8_t *bytes,
                            size_t count);

/**
 * Sends a request in the protocol's own text, and returns the value in the reply: "GAP 6, 0", "?APOS",
 * "read 0x6041" (`polepair encode --help`). PP_USAGE for what may move the motor of an axis that is not armed.
 *
 * Pointers: `axis` is NULL or valid; `text` has `length` bytes; `value` is NULL or valid.
 */
pp_status pp_axis_send(const struct pp_axis *axis,
                       const char *text,
                       size_t length,
                       int64_t *value);

/**
 * The number of parameters of an axis. A server is asked once.
 *
 * Pointers: `axis` is NULL or valid; `count` is valid.
 */
pp_status pp_axis_parameter_count(const struct pp_axis *axis, size_t *count);

/**
 * Describes the parameter at this place, from 0 on. Nothing is sent. PP_USAGE if there is none.
 *
 * Pointers: `axis` is NULL or valid; `parameter` is valid.
 */
pp_status pp_axis_parameter_at(const struct pp_axis *axis, size_t index, struct pp_parameter *parameter);

/**
 * Begins to read a parameter, and returns at once. As `pp_axis_get`.
 *
 * Example:
 *     pp_request *request;
 *     pp_axis_begin_get(axis, "max current", PP_NTS, &request);
 *     while (pp_request_poll(request) == PP_PENDING)
 *         do_something_else();
 *     double value;
 *     pp_request_value(request, &value);
 *     pp_request_close(request);
 *
 * Pointers: `axis` is NULL or valid; `name` has `length` bytes; `request` is valid.
 */
pp_status pp_axis_begin_get(const struct pp_axis *axis,
                            const char *name,
                            size_t length,
                            struct pp_request **request);

/**
 * Begins to write a parameter, and returns at once. As `pp_axis_set_text`.
 *
 * Pointers: `axis` is NULL or valid; the texts have their lengths; `request` is valid.
 */
pp_status pp_axis_begin_set_text(const struct pp_axis *axis,
                                 const char *name,
                                 size_t length,
                                 const char *value,
                                 size_t value_length,
                                 int32_t store,
                                 struct pp_request **request);

/**
 * Begins a verb, and returns at once. As `pp_axis_run`; limits are checked before.
 *
 * Pointers: `axis` and `limits` are NULL or valid; `request` is valid.
 */
pp_status pp_axis_begin(const struct pp_axis *axis,
                        pp_verb verb,
                        double target,
                        const struct pp_motion *limits,
                        struct pp_request **request);

/**
 * Polls a request: PP_PENDING before its end, PP_OK if it was executed, otherwise the status of its failure.
 *
 * Pointers: `request` is NULL or valid.
 */
pp_status pp_request_poll(const struct pp_request *request);

/**
 * Waits for the end of a request, at most `seconds`. Returns the same as `pp_request_poll`.
 *
 * Pointers: `request` is NULL or valid.
 */
pp_status pp_request_wait(const struct pp_request *request, double seconds);

/**
 * Cancels a request.
 *
 * A verb (`pp_axis_begin`): the axis is stopped, as by `pp_axis_stop`, and the request ends. A read ends at once, and
 * `pp_request_poll` then returns PP_INTERRUPTED. A write cannot be cancelled: PP_USAGE, and it continues. For a
 * request that has ended already, nothing is done.
 *
 * Returns PP_OK; PP_PENDING if the axis was stopped and the request has not ended within 10 s; the error of the stop.
 * Thread-safe.
 *
 * Example:
 *     pp_axis_begin(axis, PP_HOME, 0, NULL, &request);
 *     if (pp_request_wait(request, 30.0) == PP_PENDING)
 *         pp_request_cancel(request);
 *     pp_request_close(request);
 *
 * Pointers: `request` is NULL or valid.
 */
pp_status pp_request_cancel(const struct pp_request *request);

/**
 * Gives the value that a request has read, in the unit of its parameter. PP_USAGE before its end.
 *
 * Pointers: `request` is NULL or valid; `value` is valid.
 */
pp_status pp_request_value(const struct pp_request *request, double *value);

/**
 * Gives the value that a request has read, raw as on the wire. PP_USAGE before its end.
 *
 * Pointers: `request` is NULL or valid; `value` is valid.
 */
pp_status pp_request_raw(const struct pp_request *request, int64_t *value);

/**
 * Gives the value that a request has read, as text. PP_USAGE before its end. The buffer is used as in `pp_link_url`.
 *
 * Pointers: `request` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_request_text(const struct pp_request *request,
                          char *buffer,
                          size_t capacity,
                          size_t *needed);

/**
 * Copies the error of a request. PP_NOTHING if it has none.
 *
 * Pointers: `request` and `error` are NULL or valid.
 */
pp_status pp_request_error(const struct pp_request *request, struct pp_error *error);

/**
 * Copies the last error of a request handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
 * if no call has failed. As `pp_link_url` for the buffer.
 *
 * Pointers: `request` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_request_error_text(const struct pp_request *request,
                                char *buffer,
                                size_t capacity,
                                size_t *needed);

/**
 * Closes a request. One that has not ended continues: a motion is ended by `pp_axis_stop`.
 *
 * Pointers: `request` is NULL or a handle that no other thread uses.
 */
void pp_request_close(struct pp_request *request);

/**
 * Scans a wire for drives, by reads only: addresses `first` to `last` of a connection string without `#`.
 *
 * `*scan` is set even if the scan fails: the handle then keeps the error, and must be closed. Blocks until every
 * address was tried; `pp_scan_count` is 0 if no drive replied. Nothing moves.
 *
 * Pointers: `url` has `length` bytes; `scan` is valid.
 */
pp_status pp_scan_open(const char *url,
                       size_t length,
                       uint32_t first,
                       uint32_t last,
                       struct pp_scan **scan);

/**
 * The number of drives that were found.
 *
 * Pointers: `scan` is NULL or valid; `count` is valid.
 */
pp_status pp_scan_count(const struct pp_scan *scan, size_t *count);

/**
 * Describes the drive at this index, from 0 on.
 *
 * Pointers: `scan` is NULL or valid; `found` is valid.
 */
pp_status pp_scan_at(const struct pp_scan *scan, size_t index, struct pp_found *found);

/**
 * Copies the error of a scan. PP_NOTHING if it has none.
 *
 * Pointers: `scan` and `error` are NULL or valid.
 */
pp_status pp_scan_error(const struct pp_scan *scan, struct pp_error *error);

/**
 * Copies the last error of a scan handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
 * if no call has failed. As `pp_link_url` for the buffer.
 *
 * Pointers: `scan` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_scan_error_text(const struct pp_scan *scan,
                             char *buffer,
                             size_t capacity,
                             size_t *needed);

/**
 * Closes a scan.
 *
 * Pointers: `scan` is NULL or a handle that no other thread uses.
 */
void pp_scan_close(struct pp_scan *scan);

/**
 * Reports whether an axis has a signal: 1 or 0. Nothing is sent.
 *
 * Pointers: `axis` is NULL or valid; `has` is valid.
 */
pp_status pp_axis_has_signal(const struct pp_axis *axis, pp_signal signal, int32_t *has);

/**
 * Reads a signal now. PP_USAGE with E213 if the drive does not report it. Blocks until the drive has replied.
 *
 * Example:
 *     double speed;
 *     pp_axis_read(axis, PP_SIGNAL_VELOCITY, &speed);
 *
 * Pointers: `axis` is NULL or valid; `value` is valid.
 */
pp_status pp_axis_read(const struct pp_axis *axis, pp_signal signal, double *value);

/**
 * Reads several signals now, in as few requests as the drive allows. `values` gets `count` of them.
 *
 * Pointers: `axis` is NULL or valid; `signals` and `values` have `count` elements.
 */
pp_status pp_axis_read_all(const struct pp_axis *axis,
                           const pp_signal *signals,
                           size_t count,
                           double *values);

/**
 * The last known value of a signal, and its age in seconds. Nothing is sent, except that a server is asked.
 * PP_NOTHING if it was never read. `age` may be NULL.
 *
 * Pointers: `axis` is NULL or valid; `value` is valid; `age` is NULL or valid.
 */
pp_status pp_axis_last(const struct pp_axis *axis, pp_signal signal, double *value, double *age);

/**
 * Gives the last known state of an axis. Nothing is sent, except that a server is asked.
 *
 * Pointers: `axis` is NULL or valid; `state` is valid.
 */
pp_status pp_axis_state(const struct pp_axis *axis, struct pp_state *state);

/**
 * Gives the true state of a simulated motor. `drive` counts from 0.
 *
 * Pointers: `link` is NULL or valid; `truth` is valid.
 */
pp_status pp_simulation_truth(const struct pp_link *link, size_t drive, struct pp_truth *truth);

/**
 * Does something to a simulated drive, as `polepair act`: "supply=18", "home=0.5turn", "power-cycle"
 * (docs/reference/command-line/simulate-and-serve.md). `drive` counts from 0.
 *
 * Pointers: `link` is NULL or valid; `act` has `length` bytes.
 */
pp_status pp_simulation_act(const struct pp_link *link, size_t drive, const char *act, size_t length);

/**
 * Lets virtual time pass, in a simulation with `time=virtual`.
 *
 * Pointers: `link` is NULL or valid.
 */
pp_status pp_simulation_advance(const struct pp_link *link, double seconds);

/**
 * Begins a trace: a row of signals every `period` seconds.
 *
 * A drive on a wire of this program is read by `pp_trace_read` itself, on the thread that calls it: rows that the
 * wire is too slow for are left out, not interpolated. A server sends rows by itself.
 *
 * Example:
 *     pp_signal signals[] = { PP_SIGNAL_POSITION, PP_SIGNAL_VELOCITY };
 *     pp_trace *trace;
 *     pp_axis_trace(axis, signals, 2, 0.01, &trace);
 *     double time, row[2];
 *     while (pp_trace_read(trace, 1.0, &time, row) == PP_OK && time < 2.0)
 *         printf("%g %g %g\n", time, row[0], row[1]);
 *     pp_trace_close(trace);
 *
 * Pointers: `axis` is NULL or valid; `signals` has `count` elements; `trace` is valid.
 */
pp_status pp_axis_trace(const struct pp_axis *axis,
                        const pp_signal *signals,
                        size_t count,
                        double period,
                        struct pp_trace **trace);

/**
 * Reads the next row of a trace. Waits for it at most `seconds`, then returns PP_NOTHING.
 *
 * `*time` gets seconds: since the trace began, or since the start of the server. `row` gets a value for each
 * signal, in the order of `pp_axis_trace`.
 *
 * Pointers: `trace` is NULL or valid; `time` is valid; `row` has as many elements as the trace has signals.
 */
pp_status pp_trace_read(const struct pp_trace *trace, double seconds, double *time, double *row);

/**
 * Copies the last error of a trace. PP_NOTHING if no call has failed.
 *
 * Pointers: `trace` and `error` are NULL or valid.
 */
pp_status pp_trace_error(const struct pp_trace *trace, struct pp_error *error);

/**
 * Copies the last error of a trace handle as one text, for languages without structs: "E216: axis 1: …". PP_NOTHING
 * if no call has failed. As `pp_link_url` for the buffer.
 *
 * Pointers: `trace` is NULL or valid; `buffer` has `capacity` bytes; `needed` is NULL or valid.
 */
pp_status pp_trace_error_text(const struct pp_trace *trace,
                              char *buffer,
                              size_t capacity,
                              size_t *needed);

/**
 * Ends a trace.
 *
 * Pointers: `trace` is NULL or a handle that no other thread uses.
 */
void pp_trace_close(struct pp_trace *trace);

/**
 * Version of the binary interface of the library that is loaded. Compare it with `PP_ABI_VERSION`.
 */
uint32_t pp_abi_version(void);

/**
 * Version of the library: "0.1.0". The text is constant, ends with a zero byte, and is never freed.
 */
const char *pp_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* POLEPAIR_H */
