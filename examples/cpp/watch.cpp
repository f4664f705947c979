// Shows position, speed and current of every axis on a link, without moving any.
//
//     watch "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10
//
// The second word is how many readings are shown (5).
#include <polepair.hpp>

#include <cstdio>
#include <iostream>

int main(int argc, char **argv)
try {
    const std::pair<pp_signal, const char *> wanted[] = {
        {PP_SIGNAL_POSITION, "position"},
        {PP_SIGNAL_VELOCITY, "velocity"},
        {PP_SIGNAL_CURRENT, "current"},
    };
    polepair::Link link(argc > 1 ? argv[1] : "sim:tmcl:1,3?time=virtual");
    int readings = argc > 2 ? std::stoi(argv[2]) : 5;
    for (std::size_t at = 0; at < link.axis_count(); at++) {
        polepair::Axis axis = link.axis_at(at);
        std::printf("%s (%s)\n", axis.info().label, axis.info().title);
        // Only what this drive can tell.
        std::vector<pp_signal> signals;
        std::vector<const char *> names;
        for (auto [signal, name] : wanted) {
            if (axis.has_signal(signal)) {
                signals.push_back(signal);
                names.push_back(name);
            }
        }
        polepair::Trace trace = axis.trace(signals, 0.1);
        for (int left = readings; left > 0; left--) {
            auto row = trace.read(10.0);
            if (!row)
                break;
            for (std::size_t i = 0; i < names.size(); i++)
                std::printf("  %s %.4f", names[i], row->values[i]);
            std::puts("");
        }
    }
} catch (const polepair::Error &error) {
    std::cerr << error.code() << ": " << error.what() << "\n  try: " << error.hint() << '\n';
    return 1;
}
