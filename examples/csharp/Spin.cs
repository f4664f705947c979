// Turns a motor for a while: spin "tmcl+serial:///dev/ttyUSB0:9600#1" "60 rpm" 3
// It is stopped and switched off however this ends.
using System;
using System.Globalization;
using Polepair;

static class Spin
{
    static int Main(string[] words)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        string speed = words.Length > 1 ? words[1] : "60 rpm";
        double seconds = words.Length > 2 ? double.Parse(words[2]) : 2.0;
        using (var link = new Link(words.Length > 0 ? words[0] : "sim:tmcl?time=virtual"))
        using (Axis axis = link.AxisAt(0))
        {
            Console.WriteLine($"{axis.Title}: {axis.Caution}");
            using (axis.Armed()) // enabled where it stands
            {
                axis.Velocity(speed);
                for (int i = 0; i < 4; i++)
                {
                    link.Sleep(seconds / 4);
                    Console.WriteLine($"{axis.Read(Signal.Velocity) * 30 / Math.PI:F1} rpm");
                }
            } // stopped, switched off, disarmed
        }
        return 0;
    }
}
