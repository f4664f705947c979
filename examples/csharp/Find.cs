// Finds the drives on a link, by reads only: find tmcl+serial:///dev/ttyUSB0:9600 32
using System;
using Polepair;

static class Find
{
    static int Main(string[] words)
    {
        string url = words.Length > 0 ? words[0] : "sim:tmcl:1,3?time=virtual";
        var found = Link.Scan(url, 1, words.Length > 1 ? uint.Parse(words[1]) : 8);
        foreach (FoundDrive drive in found)
        {
            Console.WriteLine($"{drive.Number}: {drive.Title}, {drive.Identity}");
            if (drive.Clash != "")
                Console.WriteLine($"   {drive.Clash}");
        }
        if (found.Count == 0)
            Console.WriteLine("nobody answered");
        return 0;
    }
}
