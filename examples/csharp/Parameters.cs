// Reads and writes parameters by name, with units: parameters "tmcl+serial:///dev/ttyUSB0:9600#1" "max current"
// It writes back the value that it read: a drive keeps the settings it had.
using System;
using Polepair;

static class Parameters
{
    static int Main(string[] words)
    {
        string name = words.Length > 1 ? words[1] : "max current";
        using (var link = new Link(words.Length > 0 ? words[0] : "sim:tmcl?time=virtual"))
        using (Axis axis = link.AxisAt(0))
        {
            Console.WriteLine($"{axis.Label} is a {axis.Title}");
            Console.WriteLine($"{name} = {axis.GetText(name)} (on the wire {axis.GetRaw(name)})");
            Parameter parameter = axis.Parameters().Find(its => its.Name == name);
            Console.WriteLine($"{parameter.About} In the manual: {parameter.Symbol}");

            // In the parameter's own unit; text may carry another one: axis.Set(name, "1200 mA").
            axis.Set(name, axis.Get(name));

            // Outside the limits nothing is sent.
            try
            {
                axis.SetRaw(name, parameter.RawMax + 1);
                Console.WriteLine("the limit is not where the profile says");
            }
            catch (PolepairException error) when (error.Executed == false)
            {
                Console.WriteLine($"{error.Code}: {error.Message}");
            }
        }
        return 0;
    }
}
