// Finds the drives on a link, by reads only.
//
//     find tmcl+serial:///dev/ttyUSB0:9600 32
//
// The second word is the highest address that is tried (8).
#include <polepair.hpp>

#include <iostream>

int main(int argc, char **argv)
try {
    const char *url = argc > 1 ? argv[1] : "sim:tmcl:1,3?time=virtual";
    auto found = polepair::scan(url, 1, argc > 2 ? std::stoul(argv[2]) : 8);
    for (const auto &drive : found) {
        std::cout << drive.number << ": " << drive.title << ", " << drive.identity << '\n';
        if (drive.clash[0])
            std::cout << "   " << drive.clash << '\n';
    }
    if (found.empty())
        std::cout << "nobody answered\n";
} catch (const polepair::Error &error) {
    std::cerr << error.code() << ": " << error.what() << "\n  try: " << error.hint() << '\n';
    return 1;
}
