// Reads and writes parameters by name, with units.
//
//     parameters "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"
//
// It writes back the value that it read: a drive keeps the settings it had.
#include <polepair.hpp>

#include <algorithm>
#include <iostream>

int main(int argc, char **argv)
try {
    std::string_view name = argc > 2 ? argv[2] : "max current";
    polepair::Link link(argc > 1 ? argv[1] : "sim:tmcl?time=virtual");
    polepair::Axis axis = link.axis_at(0);
    std::cout << axis.info().label << " is a " << axis.info().title << '\n';

    std::cout << name << " = " << axis.text(name) << " (on the wire " << axis.raw(name) << ")\n";
    auto all = axis.parameters();
    auto found = std::find_if(all.begin(), all.end(), [&](auto &its) { return its.name == name; });
    if (found != all.end())
        std::cout << found->about << " In the manual: " << found->symbol << '\n';

    // In the parameter's own unit; text may carry another one: axis.set(name, "1200 mA").
    axis.set(name, axis.value(name));

    // Outside the limits nothing is sent.
    try {
        axis.set_raw(name, found != all.end() ? found->raw_max + 1 : INT64_MAX);
        std::cout << "the limit is not where the profile says\n";
    } catch (const polepair::Error &error) {
        if (error.executed() != false)
            throw;
        std::cout << error.code() << ": " << error.what() << '\n';
    }
} catch (const polepair::Error &error) {
    std::cerr << error.code() << ": " << error.what() << "\n  try: " << error.hint() << '\n';
    return 1;
}
