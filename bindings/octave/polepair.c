/* libpolepair for Octave and MATLAB: one function, whose first argument says what to do.
 *
 *     mkoctfile --mex polepair.c $(pkg-config --cflags --libs polepair)
 *
 *     link = polepair("open", "sim:tmcl");
 *     axis = polepair("axis", link, 1);              % the first; or by its name or number: "1"
 *     polepair("arm", axis);
 *     polepair("enable", axis);
 *     polepair("velocity", axis, "60 rpm");          % text with a unit, or a number in SI
 *     polepair("sleep", link, 2);
 *     polepair("read", axis, "velocity")
 *     polepair("close", link);                       % stops, disables and disarms
 *
 * A failed call raises an error whose identifier ends in the code: "polepair:E216". `clear polepair` and the end of
 * the program close all links, which stops what is armed. polepair.h documents the rules of each function. */
#include <mex.h>
#include <polepair.h>

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define TEXT_MAX 1024
#define HANDLES_MAX 4096
#define SIGNALS_MAX 16

static const char *const SIGNALS[SIGNALS_MAX] = { "position", "velocity", "torque", "current", "voltage",
    "temperature", "target position", "target velocity", "fault", "enabled", "moving", "reached", "mode", "time",
    "positive limit", "negative limit" };

enum kind { NO_HANDLE, LINK, AXIS, TRACE };

/* Open handles. A number that Octave has is a place here, plus one, so that a wrong number cannot crash. */
static struct handle {
    enum kind kind;
    void *pointer;
    int columns;
} handles[HANDLES_MAX];

static const char *const KINDS[] = { "handle", "link", "axis", "trace" };

/* --- Errors ------------------------------------------------------------------------------------------------------ */

static void fail(const char *code, const char *format, ...)
{
    char id[64], text[TEXT_MAX];
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    snprintf(id, sizeof id, "polepair:%s", code);
    mexErrMsgIdAndTxt(id, "%s", text);
}

static void raise_error(const pp_error *error)
{
    /* The status tells apart what code and text do not: 8 is a fault of the drive. */
    fail(error->code, "%s%s%s%s", error->message, error->hint[0] ? ". " : "", error->hint,
         error->may_turn == 1 ? " (the motor may still turn)" : "");
}

static void check_link(pp_link *link, pp_status status)
{
    pp_error error = { .size = sizeof error };

    if (status == PP_OK)
        return;
    pp_link_error(link, &error);
    raise_error(&error);
}

static void check_axis(pp_axis *axis, pp_status status)
{
    pp_error error = { .size = sizeof error };

    if (status == PP_OK)
        return;
    pp_axis_error(axis, &error);
    raise_error(&error);
}

/* --- Arguments and results --------------------------------------------------------------------------------------- */

static char *text_of(const mxArray *value, const char *what)
{
    char *text = mxIsChar(value) ? mxArrayToString(value) : NULL;

    if (text == NULL)
        fail("E260", "%s must be text", what);
    return text;
}

static double number_of(const mxArray *value, const char *what)
{
    if (!mxIsNumeric(value) && !mxIsLogical(value))
        fail("E260", "%s must be a number", what);
    return mxGetScalar(value);
}

static mxArray *add_handle(enum kind kind, void *pointer)
{
    size_t place;

    for (place = 0; place < HANDLES_MAX && handles[place].kind != NO_HANDLE; place++)
        ;
    if (place == HANDLES_MAX)
        fail("E220", "%d handles are open: close some with polepair(\"close\", handle)", HANDLES_MAX);
    handles[place].kind = kind;
    handles[place].pointer = pointer;
    return mxCreateDoubleScalar((double)place + 1);
}

static struct handle *handle_of(const mxArray *value)
{
    double number = number_of(value, "the handle");

    if (!(number >= 1 && number <= HANDLES_MAX) || handles[(size_t)number - 1].kind == NO_HANDLE)
        fail("E212", "%g is not an open handle", number);
    return &handles[(size_t)number - 1];
}

static void *typed_handle(const mxArray *value, enum kind kind)
{
    struct handle *handle = handle_of(value);

    if (handle->kind != kind)
        fail("E212", "this is the handle of a%s %s, not of a%s %s", handle->kind == AXIS ? "n" : "",
             KINDS[handle->kind], kind == AXIS ? "n" : "", KINDS[kind]);
    return handle->pointer;
}

static pp_signal signal_of(const char *name)
{
    pp_signal signal;

    for (signal = 0; signal < SIGNALS_MAX; signal++)
        if (strcmp(SIGNALS[signal], name) == 0)
            return signal;
    fail("E213", "there is no signal `%s`", name);
    return 0;
}

static mxArray *create_struct(size_t count, int fields, const char *const *names)
{
    const char *copies[16];
    int n;

    for (n = 0; n < fields; n++)
        copies[n] = names[n];
    return mxCreateStructMatrix(count, 1, fields, copies);
}

static void set_text(mxArray *value, size_t at, const char *field, const char *text)
{
    mxSetField(value, at, field, mxCreateString(text));
}

static void set_number(mxArray *value, size_t at, const char *field, double number)
{
    mxSetField(value, at, field, mxCreateDoubleScalar(number));
}

/* --- Closing ----------------------------------------------------------------------------------------------------- */

static pp_status close_handle(struct handle *handle, pp_error *error)
{
    void *pointer = handle->pointer;
    enum kind kind = handle->kind;

    handle->kind = NO_HANDLE;
    switch (kind) {
    case LINK:
        return pp_link_close(pointer, error);
    case AXIS:
        pp_axis_close(pointer);
        return PP_OK;
    case TRACE:
        pp_trace_close(pointer);
        return PP_OK;
    default:
        return PP_OK;
    }
}

static void close_all(void)
{
    size_t place;

    for (place = 0; place < HANDLES_MAX; place++)
        close_handle(&handles[place], NULL);
}

static void do_close(mxArray **out, const mxArray **in, int count)
{
    pp_error error = { .size = sizeof error };

    (void)out;
    (void)count;
    if (close_handle(handle_of(in[0]), &error) != PP_OK)
        raise_error(&error);
}

/* --- Links ------------------------------------------------------------------------------------------------------- */

static void do_open(mxArray **out, const mxArray **in, int count)
{
    pp_error error = { .size = sizeof error };
    char *url = text_of(in[0], "the connection string");
    pp_link *link;

    (void)count;
    if (pp_link_open(url, PP_NTS, &link) != PP_OK) {
        pp_link_error(link, &error);
        pp_link_close(link, NULL);
        raise_error(&error);
    }
    out[0] = add_handle(LINK, link);
}

static void do_axis_count(mxArray **out, const mxArray **in, int count)
{
    pp_link *link = typed_handle(in[0], LINK);
    size_t axes;

    (void)count;
    check_link(link, pp_link_axis_count(link, &axes));
    out[0] = mxCreateDoubleScalar((double)axes);
}

static void do_axis(mxArray **out, const mxArray **in, int count)
{
    pp_link *link = typed_handle(in[0], LINK);
    pp_axis *axis;

    (void)count;
    if (mxIsChar(in[1]))
        check_link(link, pp_link_axis(link, text_of(in[1], "the axis"), PP_NTS, &axis));
    else
        check_link(link, pp_link_axis_at(link, (size_t)(number_of(in[1], "the axis") - 1), &axis));
    out[0] = add_handle(AXIS, axis);
}

static void do_sleep(mxArray **out, const mxArray **in, int count)
{
    pp_link *link = typed_handle(in[0], LINK);

    (void)out;
    (void)count;
    check_link(link, pp_link_sleep(link, number_of(in[1], "the time")));
}

static void do_stop_all(mxArray **out, const mxArray **in, int count)
{
    pp_link *link = typed_handle(in[0], LINK);

    (void)out;
    (void)count;
    check_link(link, pp_link_stop_all(link));
}

static void do_act(mxArray **out, const mxArray **in, int count)
{
    pp_link *link = typed_handle(in[0], LINK);
    size_t drive = (size_t)(number_of(in[1], "the drive") - 1);

    (void)out;
    (void)count;
    check_link(link, pp_simulation_act(link, drive, text_of(in[2], "the act"), PP_NTS));
}

static void do_scan(mxArray **out, const mxArray **in, int count)
{
    static const char *const FIELDS[] = { "number", "profile", "title", "identity", "clash" };
    pp_error error = { .size = sizeof error };
    char *url = text_of(in[0], "the connection string");
    uint32_t first = count > 1 ? (uint32_t)number_of(in[1], "the first address") : 0;
    uint32_t last = count > 2 ? (uint32_t)number_of(in[2], "the last address") : 0;
    size_t drives = 0, at;
    pp_scan *scan;

    if (pp_scan_open(url, PP_NTS, first, last, &scan) != PP_OK) {
        pp_scan_error(scan, &error);
        pp_scan_close(scan);
        raise_error(&error);
    }
    pp_scan_count(scan, &drives);
    out[0] = create_struct(drives, 5, FIELDS);
    for (at = 0; at < drives; at++) {
        pp_found found = { .size = sizeof found };

        pp_scan_at(scan, at, &found);
        set_number(out[0], at, "number", found.number);
        set_text(out[0], at, "profile", found.profile);
        set_text(out[0], at, "title", found.title);
        set_text(out[0], at, "identity", found.identity);
        set_text(out[0], at, "clash", found.clash);
    }
    pp_scan_close(scan);
}

static void do_version(mxArray **out, const mxArray **in, int count)
{
    (void)in;
    (void)count;
    out[0] = mxCreateString(pp_version());
}

/* --- Parameters and signals ---------------------------------------------------------------------------------------- */

static void do_info(mxArray **out, const mxArray **in, int count)
{
    static const char *const FIELDS[] = { "number", "simulated", "name", "label", "protocol", "profile", "title",
        "caution", "watchdog" };
    pp_axis_info info = { .size = sizeof info };
    pp_axis *axis = typed_handle(in[0], AXIS);

    (void)count;
    check_axis(axis, pp_axis_get_info(axis, &info));
    out[0] = create_struct(1, 9, FIELDS);
    set_number(out[0], 0, "number", info.number);
    mxSetField(out[0], 0, "simulated", mxCreateLogicalScalar(info.is_simulated != 0));
    set_text(out[0], 0, "name", info.name);
    set_text(out[0], 0, "label", info.label);
    set_text(out[0], 0, "protocol", info.protocol);
    set_text(out[0], 0, "profile", info.profile);
    set_text(out[0], 0, "title", info.title);
    set_text(out[0], 0, "caution", info.caution);
    set_text(out[0], 0, "watchdog", info.watchdog);
}

static void do_parameters(mxArray **out, const mxArray **in, int count)
{
    static const char *const FIELDS[] = { "name", "symbol", "unit", "kind", "persistence", "about", "raw_min",
        "raw_max", "readable", "writable", "moves" };
    pp_axis *axis = typed_handle(in[0], AXIS);
    size_t parameters, at;

    (void)count;
    check_axis(axis, pp_axis_parameter_count(axis, &parameters));
    out[0] = create_struct(parameters, 11, FIELDS);
    for (at = 0; at < parameters; at++) {
        pp_parameter parameter = { .size = sizeof parameter };

        check_axis(axis, pp_axis_parameter_at(axis, at, &parameter));
        set_text(out[0], at, "name", parameter.name);
        set_text(out[0], at, "symbol", parameter.symbol);
        set_text(out[0], at, "unit", parameter.unit);
        set_text(out[0], at, "kind", parameter.kind);
        set_text(out[0], at, "persistence", parameter.persistence);
        set_text(out[0], at, "about", parameter.about);
        set_number(out[0], at, "raw_min", (double)parameter.raw_min);
        set_number(out[0], at, "raw_max", (double)parameter.raw_max);
        mxSetField(out[0], at, "readable", mxCreateLogicalScalar(parameter.readable != 0));
        mxSetField(out[0], at, "writable", mxCreateLogicalScalar(parameter.writable != 0));
        mxSetField(out[0], at, "moves", mxCreateLogicalScalar(parameter.moves != 0));
    }
}

static void do_get(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    double value;

    (void)count;
    check_axis(axis, pp_axis_get(axis, text_of(in[1], "the name"), PP_NTS, &value));
    out[0] = mxCreateDoubleScalar(value);
}

static void do_get_raw(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    int64_t value;

    (void)count;
    check_axis(axis, pp_axis_get_raw(axis, text_of(in[1], "the name"), PP_NTS, &value));
    out[0] = mxCreateDoubleScalar((double)value);
}

static void do_get_text(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    char *name = text_of(in[1], "the name"), *buffer = NULL;
    size_t capacity = TEXT_MAX, length = 0;
    pp_status status;

    (void)count;
    do {
        mxFree(buffer);
        buffer = mxMalloc(capacity);
        status = pp_axis_get_text(axis, name, PP_NTS, buffer, capacity, &length);
        capacity = length + 1;
    } while (status == PP_BUFFER);
    check_axis(axis, status);
    out[0] = mxCreateString(buffer);
    mxFree(buffer);
}

static void do_set(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    char *name = text_of(in[1], "the name");
    int store = count > 3 && number_of(in[3], "whether to store") != 0;

    (void)out;
    if (mxIsChar(in[2]))
        check_axis(axis, pp_axis_set_text(axis, name, PP_NTS, text_of(in[2], "the value"), PP_NTS, store));
    else if (store)
        fail("E260", "a value that is stored is given as text with its unit");
    else
        check_axis(axis, pp_axis_set(axis, name, PP_NTS, number_of(in[2], "the value")));
}

static void do_set_raw(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    int store = count > 3 && number_of(in[3], "whether to store") != 0;
    int64_t value = (int64_t)number_of(in[2], "the value");

    (void)out;
    check_axis(axis, pp_axis_set_raw(axis, text_of(in[1], "the name"), PP_NTS, value, store));
}

static void do_has_signal(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    int32_t has;

    (void)count;
    check_axis(axis, pp_axis_has_signal(axis, signal_of(text_of(in[1], "the signal")), &has));
    out[0] = mxCreateLogicalScalar(has != 0);
}

static void do_read(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    double value;

    (void)count;
    check_axis(axis, pp_axis_read(axis, signal_of(text_of(in[1], "the signal")), &value));
    out[0] = mxCreateDoubleScalar(value);
}

static void do_trace(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    size_t columns = mxIsCell(in[1]) ? mxGetNumberOfElements(in[1]) : 0, n;
    pp_signal signals[SIGNALS_MAX];
    pp_trace *trace;

    (void)count;
    if (columns == 0 || columns > SIGNALS_MAX)
        fail("E260", "the signals must be a cell array of 1 to %d names", SIGNALS_MAX);
    for (n = 0; n < columns; n++)
        signals[n] = signal_of(text_of(mxGetCell(in[1], n), "a signal"));
    check_axis(axis, pp_axis_trace(axis, signals, columns, number_of(in[2], "the period"), &trace));
    out[0] = add_handle(TRACE, trace);
    handles[(size_t)mxGetScalar(out[0]) - 1].columns = (int)columns;
}

static void do_trace_read(mxArray **out, const mxArray **in, int count)
{
    pp_trace *trace = typed_handle(in[0], TRACE);
    int columns = handle_of(in[0])->columns;
    pp_error error = { .size = sizeof error };
    double row[SIGNALS_MAX], time;
    pp_status status;

    (void)count;
    status = pp_trace_read(trace, number_of(in[1], "the time limit"), &time, row);
    if (status != PP_OK && status != PP_NOTHING) {
        pp_trace_error(trace, &error);
        raise_error(&error);
    }
    /* Without a row: an empty matrix. */
    out[0] = mxCreateDoubleMatrix(1, status == PP_OK ? columns + 1 : 0, mxREAL);
    if (status == PP_OK) {
        mxGetPr(out[0])[0] = time;
        memcpy(mxGetPr(out[0]) + 1, row, sizeof *row * (size_t)columns);
    }
}

/* --- Motion -------------------------------------------------------------------------------------------------------- */

static void do_arm(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);

    (void)out;
    (void)count;
    check_axis(axis, pp_axis_arm(axis));
}

static void do_release(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);

    (void)out;
    (void)count;
    check_axis(axis, pp_axis_release(axis));
}

static void do_stop(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);

    (void)out;
    (void)count;
    check_axis(axis, pp_axis_stop(axis));
}

static void do_wait(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);

    (void)out;
    (void)count;
    check_axis(axis, pp_axis_wait(axis, number_of(in[1], "the time")));
}

static void run_verb(const mxArray **in, int count, pp_verb verb)
{
    pp_axis *axis = typed_handle(in[0], AXIS);

    if (count > 1 && mxIsChar(in[1]))
        check_axis(axis, pp_axis_run_text(axis, verb, text_of(in[1], "the target"), PP_NTS, NULL));
    else
        check_axis(axis, pp_axis_run(axis, verb, count > 1 ? number_of(in[1], "the target") : NAN, NULL));
}

#define VERB(name, verb) \
    static void do_##name(mxArray **out, const mxArray **in, int count) \
    { \
        (void)out; \
        run_verb(in, count, verb); \
    }

VERB(enable, PP_ENABLE)
VERB(disable, PP_DISABLE)
VERB(clear, PP_CLEAR)
VERB(store, PP_STORE)
VERB(velocity, PP_VELOCITY)
VERB(torque, PP_TORQUE)
VERB(move_to, PP_MOVE_TO)
VERB(move_by, PP_MOVE_BY)
VERB(move_on, PP_MOVE_ON)

static void do_home(mxArray **out, const mxArray **in, int count)
{
    pp_axis *axis = typed_handle(in[0], AXIS);
    pp_error error = { .size = sizeof error };
    pp_request *request;
    pp_status status;

    (void)count;
    check_axis(axis, pp_axis_begin(axis, PP_HOME, NAN, NULL, &request));
    status = pp_request_wait(request, number_of(in[1], "the time limit"));
    if (status != PP_OK && status != PP_PENDING)
        pp_request_error(request, &error);
    pp_request_close(request);
    if (error.status != PP_OK)
        raise_error(&error);
    /* False: it goes on, and has not ended in time. */
    out[0] = mxCreateLogicalScalar(status == PP_OK);
}

/* --- The function ------------------------------------------------------------------------------------------------- */

static const struct command {
    const char *name;
    int least, most;
    const char *arguments;
    void (*work)(mxArray **out, const mxArray **in, int count);
} COMMANDS[] = {
    { "open", 1, 1, "connection string", do_open },
    { "close", 1, 1, "handle", do_close },
    { "axis_count", 1, 1, "link", do_axis_count },
    { "axis", 2, 2, "link, place from 1 or name", do_axis },
    { "sleep", 2, 2, "link, seconds", do_sleep },
    { "stop_all", 1, 1, "link", do_stop_all },
    { "act", 3, 3, "link, drive from 1, act", do_act },
    { "scan", 1, 3, "connection string, first, last", do_scan },
    { "version", 0, 0, "", do_version },
    { "info", 1, 1, "axis", do_info },
    { "parameters", 1, 1, "axis", do_parameters },
    { "get", 2, 2, "axis, name", do_get },
    { "get_raw", 2, 2, "axis, name", do_get_raw },
    { "get_text", 2, 2, "axis, name", do_get_text },
    { "set", 3, 4, "axis, name, number or text, store", do_set },
    { "set_raw", 3, 4, "axis, name, number, store", do_set_raw },
    { "has_signal", 2, 2, "axis, signal", do_has_signal },
    { "read", 2, 2, "axis, signal", do_read },
    { "trace", 3, 3, "axis, {signals}, period in s", do_trace },
    { "trace_read", 2, 2, "trace, seconds", do_trace_read },
    { "arm", 1, 1, "axis", do_arm },
    { "release", 1, 1, "axis", do_release },
    { "stop", 1, 1, "axis", do_stop },
    { "wait", 2, 2, "axis, seconds", do_wait },
    { "enable", 1, 1, "axis", do_enable },
    { "disable", 1, 1, "axis", do_disable },
    { "clear", 1, 1, "axis", do_clear },
    { "store", 1, 1, "axis", do_store },
    { "velocity", 2, 2, "axis, rad/s or text", do_velocity },
    { "torque", 2, 2, "axis, N m or text", do_torque },
    { "move_to", 2, 2, "axis, rad or text", do_move_to },
    { "move_by", 2, 2, "axis, rad or text", do_move_by },
    { "move_on", 2, 2, "axis, rad or text", do_move_on },
    { "home", 2, 2, "axis, seconds", do_home },
};

void mexFunction(int out_count, mxArray **out, int in_count, const mxArray **in)
{
    const struct command *command = COMMANDS, *end = COMMANDS + sizeof COMMANDS / sizeof *COMMANDS;
    mxArray *result = NULL;
    char *name;

    mexAtExit(close_all);
    if (in_count == 0)
        fail("E260", "polepair(COMMAND, …): open, axis, arm, enable, velocity, move_to, wait, read, get, set, stop, close, …");
    name = text_of(in[0], "the command");
    while (command < end && strcmp(command->name, name) != 0)
        command++;
    if (command == end)
        fail("E260", "there is no command `%s`", name);
    if (in_count - 1 < command->least || in_count - 1 > command->most)
        fail("E260", "polepair(\"%s\"%s%s)", command->name, *command->arguments ? ", " : "", command->arguments);
    command->work(&result, in + 1, in_count - 1);
    if (result != NULL)
        out[0] = result;
    else if (out_count > 0)
        fail("E260", "`%s` has no result", name);
}
