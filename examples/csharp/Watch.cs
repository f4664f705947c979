// Shows position, speed and current of every axis on a link, without moving any:
// watch "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10
using System;
using System.Globalization;
using System.Linq;
using Polepair;

static class Watch
{
    static int Main(string[] words)
    {
        CultureInfo.CurrentCulture = CultureInfo.InvariantCulture;
        int readings = words.Length > 1 ? int.Parse(words[1]) : 5;
        var wanted = new[] { Signal.Position, Signal.Velocity, Signal.Current };
        using (var link = new Link(words.Length > 0 ? words[0] : "sim:tmcl:1,3?time=virtual"))
        {
            for (int at = 0; at < link.AxisCount; at++)
            {
                using (Axis axis = link.AxisAt(at))
                {
                    Console.WriteLine($"{axis.Label} ({axis.Title})");
                    // Only what this drive can tell.
                    Signal[] signals = wanted.Where(axis.HasSignal).ToArray();
                    using (Trace trace = axis.Trace(signals, 0.1))
                    {
                        for (int left = readings; left > 0; left--)
                        {
                            double[] row = trace.Read(10.0, out _);
                            var cells = signals.Zip(row, (signal, value) => $"  {signal.ToString().ToLower()} {value:F4}");
                            Console.WriteLine(string.Concat(cells));
                        }
                    }
                }
            }
        }
        return 0;
    }
}
