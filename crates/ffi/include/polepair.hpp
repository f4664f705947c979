// polepair.hpp: libpolepair for C++17. Handles close themselves, errors are exceptions.
//
//     polepair::Link link("sim:tmcl");
//     polepair::Axis axis = link.axis("1");
//     polepair::Armed armed(axis);            // stopped, disabled and disarmed at the end of the scope
//     axis.velocity("60 rpm");
//     link.sleep(2.0);
//
// Everything here is inline: only libpolepair is linked. polepair.h documents the rules of each function.
#ifndef POLEPAIR_HPP
#define POLEPAIR_HPP

#include <polepair.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace polepair {

// What a failed call throws.
class Error : public std::runtime_error {
public:
    explicit Error(const pp_error &error) : std::runtime_error(error.message), error_(error) {}

    // PP_USAGE, PP_NO_REPLY and so on.
    pp_status status() const noexcept { return error_.status; }
    // Stable code: "E401".
    const char *code() const noexcept { return error_.code; }
    // What to try. May be empty.
    const char *hint() const noexcept { return error_.hint; }
    // Whether the drive executed the request; nothing if that is unknown.
    std::optional<bool> executed() const noexcept
    {
        if (error_.executed < 0)
            return std::nullopt;
        return error_.executed == 1;
    }
    // The motor may still turn, and only cutting its supply stops it.
    bool may_turn() const noexcept { return error_.may_turn != 0; }

private:
    pp_error error_;
};

namespace detail {

template <typename T> T sized()
{
    T value{};
    value.size = sizeof value;
    return value;
}

template <typename Handle>
void check(pp_status status, const Handle *handle, pp_status (*copy)(const Handle *, pp_error *))
{
    if (status == PP_OK)
        return;
    auto error = sized<pp_error>();
    if (copy(handle, &error) != PP_OK) {
        error.status = status;
        std::string_view("polepair: the call failed").copy(error.message, sizeof error.message - 1);
    }
    throw Error(error);
}

// Calls a function that copies text, with a buffer that is large enough.
template <typename Call, typename Check> std::string text_of(Call call, Check check)
{
    std::string text(128, '\0');
    std::size_t needed = 0;
    pp_status status;
    while ((status = call(text.data(), text.size(), &needed)) == PP_BUFFER)
        text.resize(needed + 1);
    check(status);
    text.resize(needed);
    return text;
}

struct AxisCloser { void operator()(pp_axis *axis) const { pp_axis_close(axis); } };
struct RequestCloser { void operator()(pp_request *request) const { pp_request_close(request); } };
struct TraceCloser { void operator()(pp_trace *trace) const { pp_trace_close(trace); } };
struct ScanCloser { void operator()(pp_scan *scan) const { pp_scan_close(scan); } };
// An error on the way out is lost: Link::close() tells it.
struct LinkCloser { void operator()(pp_link *link) const { pp_link_close(link, nullptr); } };

} // namespace detail

// Limits of a motion; what is not set is the drive's.
inline pp_motion motion()
{
    auto limits = detail::sized<pp_motion>();
    pp_motion_init(&limits);
    return limits;
}

// A recording in a drive's own memory, as it is usual.
inline pp_drive_log drive_log()
{
    auto log = detail::sized<pp_drive_log>();
    pp_drive_log_init(&log);
    return log;
}

// A request that was begun. Dropping it does not end it.
class Request {
public:
    explicit Request(pp_request *request) : handle_(request) {}

    // Whether it has ended; throws if it failed.
    bool poll() { return ended(pp_request_poll(handle_.get())); }
    // Waits at most so many seconds; false if it has not ended.
    bool wait(double seconds) { return ended(pp_request_wait(handle_.get(), seconds)); }
    // Stops the axis of a motion, or ends a read; false if it has not ended.
    bool cancel() { return ended(pp_request_cancel(handle_.get())); }

    double value() const
    {
        double value;
        check(pp_request_value(handle_.get(), &value));
        return value;
    }
    std::int64_t raw() const
    {
        std::int64_t raw;
        check(pp_request_raw(handle_.get(), &raw));
        return raw;
    }
    std::string text() const
    {
        return detail::text_of(
            [this](char *to, std::size_t room, std::size_t *needed) {
                return pp_request_text(handle_.get(), to, room, needed);
            },
            [this](pp_status status) { check(status); });
    }

private:
    bool ended(pp_status status) const
    {
        if (status == PP_PENDING)
            return false;
        check(status);
        return true;
    }
    void check(pp_status status) const { detail::check(status, handle_.get(), pp_request_error); }

    std::unique_ptr<pp_request, detail::RequestCloser> handle_;
};

// A row of a trace.
struct Row {
    double time;
    std::vector<double> values;
};

// Signals again and again.
class Trace {
public:
    Trace(pp_trace *trace, std::size_t columns) : handle_(trace), columns_(columns) {}

    // The next row; nothing if there is none within so many seconds.
    std::optional<Row> read(double seconds)
    {
        Row row{0, std::vector<double>(columns_)};
        pp_status status = pp_trace_read(handle_.get(), seconds, &row.time, row.values.data());
        if (status == PP_NOTHING)
            return std::nullopt;
        detail::check(status, handle_.get(), pp_trace_error);
        return row;
    }

private:
    std::unique_ptr<pp_trace, detail::TraceCloser> handle_;
    std::size_t columns_;
};

// One axis: a motor.
class Axis {
public:
    explicit Axis(pp_axis *axis) : handle_(axis) {}

    // The handle for functions of polepair.h.
    pp_axis *get() const noexcept { return handle_.get(); }

    pp_axis_info info() const
    {
        auto info = detail::sized<pp_axis_info>();
        check(pp_axis_get_info(get(), &info));
        return info;
    }

    // Limits how long calls wait; 0 for no limit.
    void set_time_limit(double seconds) { check(pp_axis_set_time_limit(get(), seconds)); }

    double value(std::string_view name) const
    {
        double value;
        check(pp_axis_get(get(), name.data(), name.size(), &value));
        return value;
    }
    std::int64_t raw(std::string_view name) const
    {
        std::int64_t raw;
        check(pp_axis_get_raw(get(), name.data(), name.size(), &raw));
        return raw;
    }
    std::string text(std::string_view name) const
    {
        return detail::text_of(
            [&](char *to, std::size_t room, std::size_t *needed) {
                return pp_axis_get_text(get(), name.data(), name.size(), to, room, needed);
            },
            [this](pp_status status) { check(status); });
    }
    void set(std::string_view name, double value)
    {
        check(pp_axis_set(get(), name.data(), name.size(), value));
    }
    void set(std::string_view name, std::string_view value, bool store = false)
    {
        check(pp_axis_set_text(get(), name.data(), name.size(), value.data(), value.size(), store));
    }
    void set_raw(std::string_view name, std::int64_t value, bool store = false)
    {
        check(pp_axis_set_raw(get(), name.data(), name.size(), value, store));
    }
    std::int64_t send(std::string_view text)
    {
        std::int64_t value;
        check(pp_axis_send(get(), text.data(), text.size(), &value));
        return value;
    }
    std::vector<pp_parameter> parameters() const
    {
        std::size_t count;
        check(pp_axis_parameter_count(get(), &count));
        std::vector<pp_parameter> all(count, detail::sized<pp_parameter>());
        for (std::size_t at = 0; at < count; at++)
            check(pp_axis_parameter_at(get(), at, &all[at]));
        return all;
    }

    bool has_signal(pp_signal signal) const
    {
        int has;
        check(pp_axis_has_signal(get(), signal, &has));
        return has != 0;
    }
    double read(pp_signal signal) const
    {
        double value;
        check(pp_axis_read(get(), signal, &value));
        return value;
    }
    std::vector<double> read(const std::vector<pp_signal> &signals) const
    {
        std::vector<double> values(signals.size());
        check(pp_axis_read_all(get(), signals.data(), signals.size(), values.data()));
        return values;
    }
    pp_state state() const
    {
        auto state = detail::sized<pp_state>();
        check(pp_axis_state(get(), &state));
        return state;
    }
    std::vector<pp_fault> faults() const
    {
        std::vector<pp_fault> all;
        std::size_t count = 1;
        while (all.size() < count) {
            auto fault = detail::sized<pp_fault>();
            check(pp_axis_fault(get(), all.size(), &fault, &count));
            if (all.size() < count)
                all.push_back(fault);
        }
        return all;
    }
    Trace trace(const std::vector<pp_signal> &signals, double period) const
    {
        pp_trace *trace;
        check(pp_axis_trace(get(), signals.data(), signals.size(), period, &trace));
        return Trace(trace, signals.size());
    }
    // Records variables, with commas in between, in the drive's own memory.
    Trace record_in_drive(std::string_view variables, const pp_drive_log &log) const
    {
        pp_trace *trace;
        check(pp_axis_record_in_drive(get(), variables.data(), variables.size(), &log, &trace));
        auto commas = std::count(variables.begin(), variables.end(), ',');
        return Trace(trace, static_cast<std::size_t>(commas) + 1);
    }

    void arm() { check(pp_axis_arm(get())); }
    void disarm() { check(pp_axis_disarm(get())); }
    // Stops, disables and disarms.
    void release() { check(pp_axis_release(get())); }
    bool is_armed() const
    {
        int armed;
        check(pp_axis_is_armed(get(), &armed));
        return armed != 0;
    }
    void stop() { check(pp_axis_stop(get())); }
    void enable() { check(pp_axis_enable(get())); }
    void disable() { check(pp_axis_disable(get())); }
    void clear() { check(pp_axis_clear(get())); }
    void home() { check(pp_axis_home(get())); }
    void velocity(double speed) { check(pp_axis_velocity(get(), speed)); }
    void velocity(std::string_view speed)
    {
        check(pp_axis_velocity_text(get(), speed.data(), speed.size()));
    }
    void move_to(double position) { check(pp_axis_move_to(get(), position)); }
    void move_to(std::string_view position)
    {
        check(pp_axis_move_to_text(get(), position.data(), position.size()));
    }
    void move_by(double distance) { check(pp_axis_move_by(get(), distance)); }
    void move_by(std::string_view distance)
    {
        check(pp_axis_move_by_text(get(), distance.data(), distance.size()));
    }
    // Lets this axis follow another one of its bus: turns of its motor to turns of the master's.
    void follow_gear(const Axis &master, int turns, int master_turns)
    {
        check(pp_axis_follow_gear(get(), master.get(), turns, master_turns));
    }
    void uncouple(const Axis &master) { check(pp_axis_uncouple(get(), master.get())); }
    void run(pp_verb verb, double target = NAN, const pp_motion &limits = motion())
    {
        check(pp_axis_run(get(), verb, target, &limits));
    }
    void run(pp_verb verb, std::string_view target, const pp_motion &limits = motion())
    {
        check(pp_axis_run_text(get(), verb, target.data(), target.size(), &limits));
    }
    Request begin(pp_verb verb, double target = NAN, const pp_motion &limits = motion())
    {
        pp_request *request;
        check(pp_axis_begin(get(), verb, target, &limits, &request));
        return Request(request);
    }
    Request begin_get(std::string_view name) const
    {
        pp_request *request;
        check(pp_axis_begin_get(get(), name.data(), name.size(), &request));
        return Request(request);
    }
    // Waits until a move has reached its target.
    void wait(double seconds) { check(pp_axis_wait(get(), seconds)); }

private:
    void check(pp_status status) const { detail::check(status, handle_.get(), pp_axis_error); }

    std::unique_ptr<pp_axis, detail::AxisCloser> handle_;
};

// Keeps an axis armed and enabled, and releases it at the end of its scope.
class Armed {
public:
    explicit Armed(Axis &axis) : axis_(&axis)
    {
        axis.arm();
        try {
            axis.enable();
        } catch (const Error &error) {
            // A drive without a switch for its power is only armed.
            if (std::string_view(error.code()) != "E218") {
                pp_axis_release(axis.get());
                throw;
            }
        }
    }
    Armed(const Armed &) = delete;
    Armed &operator=(const Armed &) = delete;
    ~Armed()
    {
        if (axis_ != nullptr)
            pp_axis_release(axis_->get());
    }

    // Stops, disables and disarms now, and throws what the destructor would lose.
    void release() { std::exchange(axis_, nullptr)->release(); }

private:
    Axis *axis_;
};

// A link: a wire, a simulation, or the axes of a running server.
class Link {
public:
    explicit Link(std::string_view url)
    {
        pp_link *link;
        pp_status status = pp_link_open(url.data(), url.size(), &link);
        handle_.reset(link);
        check(status);
    }

    // The handle for functions of polepair.h.
    pp_link *get() const noexcept { return handle_.get(); }

    std::size_t axis_count() const
    {
        std::size_t count;
        check(pp_link_axis_count(get(), &count));
        return count;
    }
    Axis axis_at(std::size_t index) const
    {
        pp_axis *axis;
        check(pp_link_axis_at(get(), index, &axis));
        return Axis(axis);
    }
    Axis axis(std::string_view name) const
    {
        pp_axis *axis;
        check(pp_link_axis(get(), name.data(), name.size(), &axis));
        return Axis(axis);
    }
    void stop_all() { check(pp_link_stop_all(get())); }
    // Waits on the link's clock.
    void sleep(double seconds) const { check(pp_link_sleep(get(), seconds)); }

    void listen() { check(pp_link_listen(get())); }
    // The next event; nothing if there is none within so many seconds.
    std::optional<pp_event> next_event(double seconds)
    {
        auto event = detail::sized<pp_event>();
        pp_status status = pp_link_next_event(get(), seconds, &event);
        if (status == PP_NOTHING)
            return std::nullopt;
        check(status);
        return event;
    }

    // Does something to a simulated drive: "supply=18".
    void act(std::size_t drive, std::string_view act)
    {
        check(pp_simulation_act(get(), drive, act.data(), act.size()));
    }
    pp_truth truth(std::size_t drive) const
    {
        auto truth = detail::sized<pp_truth>();
        check(pp_simulation_truth(get(), drive, &truth));
        return truth;
    }

    // Stops what is armed, closes the link, and throws what the destructor would lose.
    void close()
    {
        auto error = detail::sized<pp_error>();
        if (pp_link_close(handle_.release(), &error) != PP_OK)
            throw Error(error);
    }

private:
    void check(pp_status status) const { detail::check(status, handle_.get(), pp_link_error); }

    std::unique_ptr<pp_link, detail::LinkCloser> handle_;
};

// Scans a wire for drives, by reads only.
inline std::vector<pp_found> scan(std::string_view url, std::uint32_t first, std::uint32_t last)
{
    pp_scan *handle;
    pp_status status = pp_scan_open(url.data(), url.size(), first, last, &handle);
    std::unique_ptr<pp_scan, detail::ScanCloser> scan(handle);
    detail::check(status, scan.get(), pp_scan_error);
    std::size_t count;
    detail::check(pp_scan_count(scan.get(), &count), scan.get(), pp_scan_error);
    std::vector<pp_found> found(count, detail::sized<pp_found>());
    for (std::size_t at = 0; at < count; at++)
        detail::check(pp_scan_at(scan.get(), at, &found[at]), scan.get(), pp_scan_error);
    return found;
}

} // namespace polepair

#endif
