/* What the header promises: handles, errors, sizes, buffers, requests, events, threads, forks. */
#define _POSIX_C_SOURCE 200809L
#include <polepair.h>

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#define EXPECT(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition); \
            exit(1); \
        } \
    } while (0)

static pp_link *open_link(const char *url)
{
    pp_link *link;

    EXPECT(pp_link_open(url, PP_NTS, &link) == PP_OK);
    return link;
}

static pp_axis *open_axis(pp_link *link)
{
    pp_axis *axis;

    EXPECT(pp_link_axis(link, "1", 1, &axis) == PP_OK);
    return axis;
}

static void test_versions(void)
{
    EXPECT(pp_abi_version() == PP_ABI_VERSION);
    EXPECT(strchr(pp_version(), '.') != NULL);
}

static void test_null_and_wrong_input(void)
{
    pp_error error = { .size = sizeof error };
    pp_axis *axis = NULL;
    pp_link *link;
    double value;
    size_t count;

    EXPECT(pp_link_open(NULL, 0, NULL) == PP_USAGE);
    EXPECT(pp_link_open("nonsense", PP_NTS, &link) == PP_USAGE && link != NULL);
    EXPECT(pp_link_error(link, &error) == PP_OK);
    EXPECT(error.status == PP_USAGE && error.code[0] == 'E' && error.message[0] && error.executed == 0);
    EXPECT(pp_link_axis_count(link, &count) == PP_USAGE);
    EXPECT(pp_link_close(link, NULL) == PP_OK);
    EXPECT(pp_link_close(NULL, NULL) == PP_OK);
    EXPECT(pp_link_open("sim:\xff", PP_NTS, &link) == PP_USAGE);
    pp_link_close(link, NULL);

    link = open_link("sim:tmcl?time=virtual");
    EXPECT(pp_link_error(link, &error) == PP_NOTHING);
    EXPECT(pp_link_axis_at(link, 7, &axis) == PP_USAGE && axis == NULL);
    EXPECT(pp_link_axis(link, "99", 2, &axis) == PP_USAGE && axis == NULL);
    axis = open_axis(link);
    EXPECT(pp_axis_get(axis, NULL, 0, &value) == PP_USAGE);
    EXPECT(pp_axis_get(axis, "max current", PP_NTS, NULL) == PP_USAGE);
    EXPECT(pp_axis_get(NULL, "max current", PP_NTS, &value) == PP_USAGE);
    EXPECT(pp_axis_get(axis, "max curent", PP_NTS, &value) == PP_USAGE);
    EXPECT(pp_axis_error(axis, &error) == PP_OK && strstr(error.message, "max current"));
    EXPECT(pp_axis_run(axis, 77, 0, NULL) == PP_USAGE);
    EXPECT(pp_axis_read(axis, 77, &value) == PP_USAGE);
    EXPECT(pp_axis_wait(axis, NAN) == PP_USAGE);
    EXPECT(pp_axis_wait(axis, -1) == PP_USAGE);
    EXPECT(pp_axis_wait(axis, INFINITY) == PP_USAGE);
    EXPECT(pp_axis_velocity(axis, NAN) == PP_USAGE);
    pp_axis_close(axis);
    pp_axis_close(NULL);
    EXPECT(pp_link_close(link, NULL) == PP_OK);
}

static void test_sizes_and_buffers(void)
{
    struct { pp_axis_info info; unsigned char behind[64]; } room;
    pp_axis_info info = { .size = 8 };
    pp_link *link = open_link("sim:tmcl?time=virtual");
    pp_axis *axis = open_axis(link);
    unsigned char bytes[4];
    char small[4], text[64];
    size_t needed, i;

    /* An older program knows less of a struct: nothing behind it is written. */
    memset(&room, 0xA5, sizeof room);
    room.info.size = 16;
    EXPECT(pp_axis_get_info(axis, &room.info) == PP_OK && room.info.number == 1 && room.info.size == 16);
    for (i = 16; i < sizeof room; i++)
        EXPECT(((unsigned char *)&room)[i] == 0xA5);
    /* A newer one knows more: the rest stays as it is. */
    memset(&room, 0xA5, sizeof room);
    room.info.size = sizeof room;
    EXPECT(pp_axis_get_info(axis, &room.info) == PP_OK && strstr(room.info.title, "TMCM"));
    for (i = 0; i < sizeof room.behind; i++)
        EXPECT(room.behind[i] == 0xA5);
    info.size = 0;
    EXPECT(pp_axis_get_info(axis, &info) == PP_USAGE);
    EXPECT(pp_axis_get_info(axis, NULL) == PP_USAGE);

    EXPECT(pp_axis_get_text(axis, "max current", PP_NTS, NULL, 0, &needed) == PP_BUFFER && needed == 4);
    EXPECT(pp_axis_get_text(axis, "max current", PP_NTS, small, sizeof small, &needed) == PP_BUFFER);
    EXPECT(pp_axis_get_text(axis, "max currentXX", 11, text, sizeof text, NULL) == PP_OK);
    EXPECT(strcmp(text, "10 A") == 0);
    EXPECT(pp_axis_get_bytes(axis, "max current", PP_NTS, bytes, sizeof bytes, &needed) == PP_USAGE);
    EXPECT(pp_link_url(link, text, sizeof text, &needed) == PP_OK && needed == strlen(text));
    pp_axis_close(axis);
    pp_link_close(link, NULL);
}

static void test_parameters(void)
{
    pp_parameter parameter = { .size = sizeof parameter };
    pp_error error = { .size = sizeof error };
    pp_link *link = open_link("sim:tmcl?time=virtual");
    pp_axis *axis = open_axis(link);
    double value;
    int64_t raw;
    size_t count;

    EXPECT(pp_axis_set(axis, "max current", PP_NTS, 1.2) == PP_OK);
    EXPECT(pp_axis_get(axis, "max current", PP_NTS, &value) == PP_OK && fabs(value - 1.2) < 1e-9);
    EXPECT(pp_axis_set_text(axis, "max current", PP_NTS, "800 mA", PP_NTS, 0) == PP_OK);
    EXPECT(pp_axis_get_raw(axis, "AP 6", PP_NTS, &raw) == PP_OK && raw == 8);
    EXPECT(pp_axis_set_raw(axis, "AP 6", PP_NTS, 1 << 20, 0) == PP_USAGE);
    EXPECT(pp_axis_error(axis, &error) == PP_OK && strcmp(error.code, "E216") == 0 && error.executed == 0);
    EXPECT(pp_axis_set_text(axis, "max current", PP_NTS, "2 furlong", PP_NTS, 0) == PP_USAGE);
    EXPECT(pp_axis_send(axis, "GAP 6, 0", PP_NTS, &raw) == PP_OK && raw == 8);
    EXPECT(pp_axis_send(axis, "ROR 0, 100", PP_NTS, NULL) == PP_USAGE);
    EXPECT(pp_axis_parameter_count(axis, &count) == PP_OK && count > 50);
    EXPECT(pp_axis_parameter_at(axis, 0, &parameter) == PP_OK && parameter.name[0]);
    EXPECT(pp_axis_parameter_at(axis, count, &parameter) == PP_USAGE);
    pp_axis_close(axis);
    pp_link_close(link, NULL);
}

static void test_motion(void)
{
    pp_motion limits = { .size = sizeof limits };
    pp_error error = { .size = sizeof error };
    pp_truth truth = { .size = sizeof truth };
    pp_state state = { .size = sizeof state };
    pp_link *link = open_link("sim:tmcl?time=virtual");
    pp_axis *axis = open_axis(link);
    double value, age;
    pp_fault fault = { .size = sizeof fault };
    size_t faults;
    int armed;

    EXPECT(pp_axis_velocity(axis, 10) == PP_USAGE);
    EXPECT(pp_axis_error(axis, &error) == PP_OK && strcmp(error.code, "E219") == 0);
    EXPECT(pp_axis_arm(axis) == PP_OK && pp_axis_arm(axis) == PP_USAGE);
    EXPECT(pp_axis_is_armed(axis, &armed) == PP_OK && armed == 1);
    EXPECT(pp_axis_enable(axis) == PP_OK);
    EXPECT(pp_axis_velocity(axis, 10) == PP_OK);
    pp_link_sleep(link, 1);
    EXPECT(pp_simulation_truth(link, 0, &truth) == PP_OK && fabs(truth.velocity - 10) < 0.5);
    EXPECT(pp_axis_read(axis, PP_SIGNAL_VELOCITY, &value) == PP_OK && fabs(value - 10) < 0.5);
    EXPECT(pp_axis_last(axis, PP_SIGNAL_VELOCITY, &value, &age) == PP_OK && fabs(value - 10) < 0.5);
    EXPECT(pp_axis_state(axis, &state) == PP_OK && state.armed == 1);
    EXPECT(pp_axis_stop(axis) == PP_OK);
    pp_motion_init(&limits);
    limits.velocity = 20;
    EXPECT(pp_axis_run_text(axis, PP_MOVE_BY, "1 turn", PP_NTS, &limits) == PP_OK);
    EXPECT(pp_axis_wait(axis, 1e-3) == PP_NEGATIVE);
    EXPECT(pp_axis_wait(axis, 60) == PP_OK);
    EXPECT(pp_axis_fault(axis, 0, &fault, &faults) == PP_OK && faults == 0);
    EXPECT(pp_simulation_act(link, 0, "supply=8", PP_NTS) == PP_OK);
    EXPECT(pp_simulation_act(link, 0, "nonsense", PP_NTS) == PP_USAGE);
    pp_link_sleep(link, 1);
    EXPECT(pp_axis_fault(axis, 0, &fault, &faults) == PP_OK && faults == 1 && fault.name[0]);
    EXPECT(pp_simulation_act(link, 0, "supply=24", PP_NTS) == PP_OK);
    pp_link_sleep(link, 1);
    EXPECT(pp_axis_clear(axis) == PP_OK && pp_axis_enable(axis) == PP_OK);
    EXPECT(pp_axis_velocity(axis, 10) == PP_OK);
    EXPECT(pp_link_stop_all(link) == PP_OK);
    EXPECT(pp_axis_release(axis) == PP_OK && pp_axis_is_armed(axis, &armed) == PP_OK && armed == 0);
    EXPECT(pp_axis_set_watchdog(axis, 1.0) == PP_OK && pp_axis_watchdog(axis, &value) == PP_OK);
    EXPECT(fabs(value - 1.0) < 0.01 && pp_axis_set_watchdog(axis, 0) == PP_OK);
    pp_axis_close(axis);
    EXPECT(pp_link_close(link, NULL) == PP_OK);
}

static void test_closing_stops(void)
{
    pp_error error = { .size = sizeof error };
    pp_link *link = open_link("sim:tmcl?time=virtual");
    pp_axis *axis = open_axis(link);
    double value;

    EXPECT(pp_axis_arm(axis) == PP_OK && pp_axis_enable(axis) == PP_OK);
    EXPECT(pp_axis_velocity(axis, 10) == PP_OK);
    EXPECT(pp_link_close(link, &error) == PP_OK);
    /* The handle is there, the link is not. */
    EXPECT(pp_axis_get(axis, "max current", PP_NTS, &value) == PP_USAGE);
    EXPECT(pp_axis_error(axis, &error) == PP_OK && strstr(error.message, "closed"));
    pp_axis_close(axis);
}

static void test_requests(void)
{
    pp_error error = { .size = sizeof error };
    pp_link *link = open_link("sim:tmcl");
    pp_axis *axis = open_axis(link);
    pp_request *request;
    pp_status status;
    char text[512];
    double value;
    int64_t raw;

    EXPECT(pp_axis_begin_get(axis, "max current", PP_NTS, &request) == PP_OK);
    while ((status = pp_request_poll(request)) == PP_PENDING)
        ;
    EXPECT(status == PP_OK && pp_request_poll(request) == PP_OK);
    EXPECT(pp_request_value(request, &value) == PP_OK && value == 10);
    EXPECT(pp_request_raw(request, &raw) == PP_OK && raw == 100);
    EXPECT(pp_request_text(request, text, sizeof text, NULL) == PP_OK && strcmp(text, "10 A") == 0);
    pp_request_close(request);
    EXPECT(pp_axis_begin_get(axis, "no such", PP_NTS, &request) == PP_USAGE && request == NULL);
    EXPECT(pp_axis_begin_set_text(axis, "max current", PP_NTS, "2 A", PP_NTS, 0, &request) == PP_OK);
    EXPECT(pp_request_wait(request, 10) == PP_OK && pp_request_value(request, &value) == PP_USAGE);
    pp_request_close(request);
    /* A read ends, a write goes on, a motion is stopped. */
    EXPECT(pp_axis_begin_get(axis, "max current", PP_NTS, &request) == PP_OK);
    EXPECT(pp_request_cancel(request) == PP_OK && pp_request_poll(request) == PP_INTERRUPTED);
    pp_request_close(request);
    EXPECT(pp_axis_begin_set_text(axis, "max current", PP_NTS, "10 A", PP_NTS, 0, &request) == PP_OK);
    EXPECT(pp_request_cancel(request) == PP_USAGE && pp_request_wait(request, 10) == PP_OK);
    EXPECT(pp_request_error_text(request, text, sizeof text, NULL) == PP_OK && strncmp(text, "E260: ", 6) == 0);
    EXPECT(pp_request_cancel(request) == PP_OK);
    pp_request_close(request);
    EXPECT(pp_axis_arm(axis) == PP_OK && pp_axis_begin(axis, PP_HOME, 0, NULL, &request) == PP_OK);
    EXPECT(pp_request_cancel(request) == PP_OK && pp_request_poll(request) != PP_PENDING);
    EXPECT(pp_axis_read(axis, PP_SIGNAL_VELOCITY, &value) == PP_OK && value == 0);
    pp_request_close(request);
    EXPECT(pp_axis_disarm(axis) == PP_OK);
    EXPECT(pp_axis_begin(axis, PP_VELOCITY, 5, NULL, &request) == PP_USAGE);
    EXPECT(pp_axis_error_text(axis, text, 4, NULL) == PP_BUFFER);
    EXPECT(pp_axis_error_text(axis, text, sizeof text, NULL) == PP_OK && strncmp(text, "E219: ", 6) == 0);
    EXPECT(pp_axis_error(axis, &error) == PP_OK && strcmp(error.code, "E219") == 0);
    /* The link goes first. */
    EXPECT(pp_axis_begin_get(axis, "max current", PP_NTS, &request) == PP_OK);
    EXPECT(pp_link_close(link, NULL) == PP_OK);
    status = pp_request_wait(request, 10);
    EXPECT(status == PP_USAGE && pp_request_poll(request) == status);
    EXPECT(pp_request_error(request, &error) == PP_OK && error.message[0]);
    pp_request_close(request);
    pp_axis_close(axis);
}

static void test_traces(void)
{
    pp_signal signals[] = { PP_SIGNAL_POSITION, PP_SIGNAL_VELOCITY };
    pp_link *link = open_link("sim:tmcl?time=virtual");
    pp_axis *axis = open_axis(link);
    double time, last = -1, row[2];
    pp_trace *trace;
    int i;

    EXPECT(pp_axis_trace(axis, signals, 0, 0.1, &trace) == PP_USAGE && trace == NULL);
    EXPECT(pp_axis_trace(axis, signals, 2, -1, &trace) == PP_USAGE);
    EXPECT(pp_axis_trace(axis, signals, 2, 0.1, &trace) == PP_OK);
    for (i = 0; i < 5; i++) {
        EXPECT(pp_trace_read(trace, 1, &time, row) == PP_OK && time > last && row[1] == 0);
        last = time;
    }
    EXPECT(pp_trace_read(trace, 0.001, &time, row) == PP_NOTHING);
    EXPECT(pp_trace_read(trace, 1, &time, NULL) == PP_USAGE);
    pp_trace_close(trace);
    pp_axis_close(axis);
    pp_link_close(link, NULL);
}

static void start_move(void *axis)
{
    EXPECT(pp_axis_run_text(axis, PP_MOVE_BY, "0.1 turn", PP_NTS, NULL) == PP_OK);
}

static void test_recordings_in_the_drive(void)
{
    pp_drive_log log = { .size = sizeof log };
    pp_link *link = open_link("sim:tmlcan?time=virtual");
    pp_axis *axis = open_axis(link);
    double time, row[2] = { 0, 0 };
    pp_trace *trace;
    int rows = 0;

    pp_drive_log_init(&log);
    EXPECT(log.size == sizeof log && log.rate == 1000 && log.inferred == 0);
    EXPECT(pp_axis_record_in_drive(axis, "APOS", PP_NTS, NULL, &trace) == PP_USAGE && trace == NULL);
    log.inferred = 1;
    EXPECT(pp_axis_record_in_drive(axis, "no such", PP_NTS, &log, &trace) == PP_USAGE);
    log.rate = 0;
    EXPECT(pp_axis_record_in_drive(axis, "APOS", PP_NTS, &log, &trace) == PP_USAGE);
    log.rate = 1000;
    log.first_address = 0x10000;
    EXPECT(pp_axis_record_in_drive(axis, "APOS", PP_NTS, &log, &trace) == PP_USAGE);
    log.first_address = 0;
    log.started = start_move;
    log.context = axis;
    EXPECT(pp_axis_arm(axis) == PP_OK && pp_axis_enable(axis) == PP_OK);
    EXPECT(pp_axis_record_in_drive(axis, "absolute time, APOS", PP_NTS, &log, &trace) == PP_OK);
    while (pp_trace_read(trace, 0, &time, row) == PP_OK) {
        EXPECT(time > rows * 0.001 - 1e-6 && time < rows * 0.001 + 1e-6);
        rows++;
    }
    /* A tenth of a turn, in rad. */
    EXPECT(rows == 200 && row[1] > 0.6 && row[1] < 0.65);
    EXPECT(pp_trace_read(trace, 0, &time, row) == PP_NOTHING);
    pp_trace_close(trace);
    /* The condition is true at once. */
    log.started = NULL;
    log.on = "APOS > 0.05turn";
    log.seconds = 0.01;
    EXPECT(pp_axis_record_in_drive(axis, "APOS", PP_NTS, &log, &trace) == PP_OK);
    pp_trace_close(trace);
    pp_axis_close(axis);
    pp_link_close(link, NULL);
}

static void test_coupling(void)
{
    const double points[] = { 0, 0, 6.2832, 3.1416 };
    pp_link *link = open_link("sim:tmlcan:1,2?time=virtual");
    pp_axis *master, *axis;
    double position;

    EXPECT(pp_link_axis_at(link, 0, &master) == PP_OK && pp_link_axis_at(link, 1, &axis) == PP_OK);
    EXPECT(pp_axis_follow_gear(axis, NULL, 1, 2) == PP_USAGE);
    EXPECT(pp_axis_follow_gear(axis, axis, 1, 2) == PP_USAGE);
    EXPECT(pp_axis_follow_gear(axis, master, 1, 0) == PP_USAGE);
    EXPECT(pp_axis_arm(axis) == PP_OK && pp_axis_enable(axis) == PP_OK);
    EXPECT(pp_axis_arm(master) == PP_OK && pp_axis_enable(master) == PP_OK);
    EXPECT(pp_axis_follow_gear(axis, master, 1, 2) == PP_OK);
    EXPECT(pp_axis_move_to(master, 6.2832) == PP_OK && pp_axis_wait(master, 60) == PP_OK);
    EXPECT(pp_axis_read(axis, PP_SIGNAL_POSITION, &position) == PP_OK);
    EXPECT(position > 3.0 && position < 3.2);
    EXPECT(pp_axis_uncouple(axis, master) == PP_OK);
    EXPECT(pp_axis_follow_cam(axis, master, points, 2, 0, 0, 0) == PP_USAGE);
    EXPECT(pp_axis_follow_cam(axis, master, points, 1, 0, 0, 1) == PP_USAGE);
    EXPECT(pp_axis_follow_cam(axis, master, NULL, 2, 0, 0, 1) == PP_USAGE);
    EXPECT(pp_axis_follow_cam(axis, master, points, 2, 0, 0, 1) == PP_OK);
    EXPECT(pp_axis_move_to(master, 0) == PP_OK && pp_axis_wait(master, 60) == PP_OK);
    EXPECT(pp_axis_read(axis, PP_SIGNAL_POSITION, &position) == PP_OK);
    EXPECT(position > -0.1 && position < 0.1);
    EXPECT(pp_axis_uncouple(axis, master) == PP_OK);
    pp_axis_close(master);
    pp_axis_close(axis);
    pp_link_close(link, NULL);
}

static void count_event(const pp_event *event, void *user)
{
    if (event->kind == PP_EVENT_ARMED || event->kind == PP_EVENT_DISARMED)
        ++*(atomic_int *)user;
}

static void test_events(void)
{
    pp_event event = { .size = sizeof event };
    pp_link *link = open_link("sim:tmcl?time=virtual");
    pp_axis *axis = open_axis(link);
    atomic_int counted = 0;
    uint64_t lost;
    int i;

    EXPECT(pp_link_next_event(link, 0, &event) == PP_USAGE);
    EXPECT(pp_link_listen(link) == PP_OK && pp_link_listen(link) == PP_USAGE);
    EXPECT(pp_link_next_event(link, 0, &event) == PP_NOTHING);
    EXPECT(pp_axis_arm(axis) == PP_OK);
    EXPECT(pp_link_next_event(link, 1, &event) == PP_OK && event.kind == PP_EVENT_ARMED && event.axis == 1);
    EXPECT(strcmp(event.text, "axis 1: armed") == 0 && isnan(event.value));
    EXPECT(pp_link_lost_events(link, &lost) == PP_OK && lost == 0);
    pp_axis_close(axis);
    pp_link_close(link, NULL);

    link = open_link("sim:tmcl");
    axis = open_axis(link);
    EXPECT(pp_link_set_event_handler(link, NULL, NULL) == PP_USAGE);
    EXPECT(pp_link_set_event_handler(link, count_event, (void *)&counted) == PP_OK);
    EXPECT(pp_axis_arm(axis) == PP_OK && pp_axis_disarm(axis) == PP_OK);
    for (i = 0; i < 12000 && counted < 2; i++)
        pp_link_sleep(link, 0.01);
    EXPECT(counted == 2);
    pp_axis_close(axis);
    EXPECT(pp_link_close(link, NULL) == PP_OK);
}

struct work { pp_link *link; int calls; };

static void *read_often(void *argument)
{
    struct work *work = argument;
    pp_axis *axis = open_axis(work->link);
    double value;
    int i;

    for (i = 0; i < work->calls; i++) {
        EXPECT(pp_axis_get(axis, "max current", PP_NTS, &value) == PP_OK && value == 10);
        pp_axis_last(axis, PP_SIGNAL_POSITION, &value, NULL);
        if (i % 8 == 0)
            EXPECT(pp_axis_get(axis, "no such", PP_NTS, &value) == PP_USAGE);
    }
    pp_axis_close(axis);
    return NULL;
}

static void test_threads(int calls)
{
    struct work work = { open_link("sim:tmcl?time=virtual"), calls };
    pthread_t threads[8];
    int i;

    for (i = 0; i < 8; i++)
        EXPECT(pthread_create(&threads[i], NULL, read_often, &work) == 0);
    for (i = 0; i < 8; i++)
        pthread_join(threads[i], NULL);
    pp_link_close(work.link, NULL);
}

static void test_forks(void)
{
    pp_link *link = open_link("sim:tmcl"), *other;
    pp_axis *axis = open_axis(link);
    pid_t child = fork();
    double value;
    int status;

    EXPECT(child >= 0);
    if (child == 0) {
        int refused = pp_axis_get(axis, "max current", PP_NTS, &value) == PP_FORKED
            && pp_axis_stop(axis) == PP_FORKED && pp_link_open("sim:tmcl", PP_NTS, &other) == PP_FORKED;

        pp_axis_close(axis);
        pp_link_close(link, NULL);
        _exit(refused ? 0 : 1);
    }
    EXPECT(waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0);
    EXPECT(pp_axis_get(axis, "max current", PP_NTS, &value) == PP_OK);
    pp_axis_close(axis);
    pp_link_close(link, NULL);
}

/* Without an argument everything; with a number that many rounds of each thread, and no fork. */
int main(int argc, char **argv)
{
    int rounds = argc > 1 ? atoi(argv[1]) : 0;

    test_versions();
    test_null_and_wrong_input();
    test_sizes_and_buffers();
    test_parameters();
    test_motion();
    test_closing_stops();
    test_requests();
    test_traces();
    test_recordings_in_the_drive();
    test_coupling();
    test_events();
    test_threads(rounds > 0 ? rounds : 500);
    if (rounds == 0)
        test_forks();
    puts("rules hold");
    return 0;
}
