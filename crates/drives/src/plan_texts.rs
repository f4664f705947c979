//! Generated from profiles/*.toml by `cargo xtask codegen`; do not edit.

/// Fragments and plans by the profile's name.
pub static PLAN_TEXTS: &[(&str, &str)] = &[
    (
        "cia402-vl",
        r##"[fragments]
check-fault = [
"send 0 1 0",
"require statusword & 0x0008 == 0 else The drive has a fault: see `fault`, take its cause away, then clear it",
]
power-up = [
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"write controlword = 6",
"until statusword & 0x6F == 0x21 within 1 s",
"write controlword = 7",
"until statusword & 0x6F == 0x23 within 1 s",
"end",
"write controlword = 15",
"until statusword & 0x6F == 0x27 within 10 s",
"end",
]
check-factor = [
"with vl dimension numerator",
"require vl dimension numerator == 1 else The drive counts speeds in steps of its own (604Ch): it needs a profile that knows them",
"require vl dimension divisor == 1 else The drive counts speeds in steps of its own (604Ch): it needs a profile that knows them",
"end",
]
[plans.enable]
source = "CiA 402-2"
steps = [
"use check-fault",
"unless statusword & 0x6F == 0x27",
"write vl target velocity = 0",
"use power-up",
"end",
]
undo = ["write controlword = 0"]
[plans.disable]
source = "CiA 402-2"
steps = [
"write controlword = 0",
]
[plans.stop]
source = "CiA 402-2 (velocity mode)"
steps = [
"if statusword & 0x6F == 0x27",
"write controlword = 0x017F",
"end",
"write vl target velocity = 0",
"standstill within 60 s",
]
[plans.quick-stop]
source = "CiA 402-2"
steps = [
"write controlword = 2",
"standstill within 10 s",
]
[plans.clear]
source = "CiA 402-2"
steps = [
"if statusword & 0x0008 != 0",
"write controlword = 0",
"wait 20 ms",
"write controlword = 0x80",
"wait 20 ms",
"await statusword & 0x0008 == 0 within 300 ms",
"write controlword = 0",
"unless statusword & 0x0008 == 0",
"wait 200 ms",
"write controlword = 0x80",
"wait 200 ms",
"write controlword = 0",
"end",
"until statusword & 0x0008 == 0 within 2 s",
"end",
]
undo = ["write controlword = 0"]
[plans.velocity]
source = "CiA 402-2 (velocity mode)"
steps = [
"use check-fault",
"use check-factor",
"write vl target velocity = {velocity}",
"write mode = 2",
"until mode display == 2 within 1 s",
"use power-up",
"write controlword = 0x7F",
]
undo = ["write vl target velocity = 0"]
[plans.store]
source = "CiA 301"
steps = [
"write store = 0x65766173",
]
"##,
    ),
    (
        "cia402",
        r##"[fragments]
check-fault = [
"send 0 1 0",
"require statusword & 0x0008 == 0 else The drive has a fault: see `fault`, take its cause away, then clear it",
]
switch-on = [
"unless statusword & 0x6F == 0x07",
"write controlword = 6",
"until statusword & 0x6F == 0x21 within 1 s",
"write controlword = 7",
"until statusword & 0x6F == 0x23 within 1 s",
"end",
"write controlword = 15",
"until statusword & 0x6F == 0x27 within 10 s",
]
free-handshake = [
"unless statusword & 0x1000 == 0",
"await statusword & 0x1000 == 0 within 300 ms",
"unless statusword & 0x1000 == 0",
"copy position actual -> target position",
"write controlword = 0x3F",
"write controlword = 15",
"until statusword & 0x1000 == 0 within 1 s",
"write target position = {target}",
"end",
"end",
]
power-up = [
"unless statusword & 0x6F == 0x27",
"use switch-on",
"end",
]
[plans.enable]
source = "CiA 402-2"
steps = [
"use check-fault",
"unless statusword & 0x6F == 0x27",
"write target velocity = 0",
"write target torque = 0",
"copy position actual -> target position",
"use switch-on",
"end",
]
undo = ["write controlword = 0"]
[plans.disable]
source = "CiA 402-2"
steps = [
"write controlword = 0",
]
[plans.stop]
source = "CiA 402-2"
steps = [
"if statusword & 0x6F == 0x27",
"write controlword = 0x010F",
"end",
"write target velocity = 0",
"write target torque = 0",
"standstill within 10 s",
]
[plans.quick-stop]
source = "CiA 402-2"
steps = [
"write controlword = 2",
"standstill within 5 s",
]
[plans.clear]
source = "CiA 402-2"
steps = [
"if statusword & 0x0008 != 0",
"write controlword = 0",
"wait 20 ms",
"write controlword = 0x80",
"wait 20 ms",
"await statusword & 0x0008 == 0 within 300 ms",
"write controlword = 0",
"unless statusword & 0x0008 == 0",
"wait 200 ms",
"write controlword = 0x80",
"wait 200 ms",
"write controlword = 0",
"end",
"until statusword & 0x0008 == 0 within 2 s",
"end",
]
undo = ["write controlword = 0"]
[plans.velocity]
source = "CiA 402-2"
steps = [
"use check-fault",
"write profile acceleration = {acceleration?}",
"write profile deceleration = {acceleration?}",
"write profile deceleration = {deceleration?}",
"write target velocity = {velocity}",
"write mode = 3",
"until mode display == 3 within 1 s",
"use power-up",
"write controlword = 15",
]
undo = ["write target velocity = 0"]
[plans.torque]
source = "CiA 402-2"
steps = [
"use check-fault",
"write target torque = {torque}",
"write mode = 4",
"until mode display == 4 within 1 s",
"use power-up",
"write controlword = 15",
]
undo = ["write target torque = 0"]
[plans.move-to]
source = "CiA 402-2"
steps = [
"use check-fault",
"write target position = {target}",
"write profile velocity = {velocity?}",
"write profile acceleration = {acceleration?}",
"write profile deceleration = {acceleration?}",
"write profile deceleration = {deceleration?}",
"write mode = 1",
"until mode display == 1 within 1 s",
"use power-up",
"unless controlword & 0x0110 == 0x0100",
"write controlword = 15",
"end",
"use free-handshake",
"write controlword = 0x3F",
"until statusword & 0x1000 == 0x1000 within 1 s",
"write controlword = 15",
]
undo = ["write controlword = 0x010F"]
[plans.move-by]
source = "CiA 402-2"
steps = [
"use check-fault",
"write target position = {target}",
"write profile velocity = {velocity?}",
"write profile acceleration = {acceleration?}",
"write profile deceleration = {acceleration?}",
"write profile deceleration = {deceleration?}",
"if controlword & 0x0100 != 0",
"write target velocity = 0",
"write mode = 3",
"until mode display == 3 within 1 s",
"end",
"write mode = 1",
"until mode display == 1 within 1 s",
"use power-up",
"unless controlword & 0x0110 == 0x0100",
"write controlword = 15",
"end",
"use free-handshake",
"write controlword = 0x7F",
"until statusword & 0x1000 == 0x1000 within 1 s",
"write controlword = 15",
]
undo = ["write controlword = 0x010F"]
[plans.home]
source = "CiA 402-2"
steps = [
"use check-fault",
"require homing method != 0 else Homing method 0 means that nothing is homed: set it first",
"write homing speed switch = {velocity?}",
"write mode = 6",
"until mode display == 6 within 1 s",
"use power-up",
"write controlword = 15",
"write controlword = 0x1F",
"unless homing method in 35 37",
"await statusword & 0x3000 == 0 within 300 ms",
"if statusword & 0x3000 != 0",
"until statusword & 0x2400 != 0 within 120 s",
"end",
"homed statusword & 0x3000 != 0 within 120 s",
"end",
"until statusword & 0x3000 != 0 within 120 s",
"require statusword & 0x2000 == 0 else Homing failed: look at switches, speeds and method",
"write controlword = 15",
]
undo = ["write controlword = 0x010F"]
[plans.store]
source = "CiA 301"
steps = [
"write store = 0x65766173",
]
[plans.follow-position]
source = "CiA 301 (7.5.2.36), CiA 402-2 (cyclic synchronous modes)"
steps = [
"require statusword & 0x0008 == 0 else The drive has a fault: see `fault`, take its cause away, then clear it",
"read position actual",
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"send 0 128 0",
"end",
"end",
"send 6 1 0",
"write rpdo 1 transmission = 1",
"write rpdo 1 entries = 0",
"write rpdo 1 entry 1 = 0x607A0020",
"with supported modes",
"with interpolation position",
"if supported modes & 0xC0 == 0x40",
"write rpdo 1 entry 1 = 0x60C10120",
"end",
"end",
"end",
"write rpdo 1 entry 2 = 0x60400010",
"write rpdo 1 entries = 2",
"send 6 1 1",
"send 7 1 0",
"write tpdo 1 transmission = 1",
"write tpdo 1 entries = 0",
"write tpdo 1 entry 1 = 0x60410010",
"write tpdo 1 entry 2 = 0x60640020",
"write tpdo 1 entries = 2",
"send 7 1 1",
"with interpolation period",
"write interpolation exponent = -3",
"write interpolation period = {period}",
"end",
"with sync period",
"write sync period = 0",
"with sync counter",
"ensure sync counter = 0",
"end",
"write sync period = {period}",
"end",
"with lost connection option",
"ensure lost connection option = 3",
"end",
"with consumer heartbeat",
"if consumer heartbeat == 0",
"send 8 150 0",
"end",
"end",
"copy position actual -> target position",
"if rpdo 1 entry 1 == 0x60C10120",
"copy position actual -> interpolation position",
"write mode = 7",
"until mode display == 7 within 1 s",
"end",
"unless rpdo 1 entry 1 == 0x60C10120",
"write mode = 8",
"until mode display == 8 within 1 s",
"end",
"send 0 1 0",
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"write controlword = 6",
"until statusword & 0x6F == 0x21 within 1 s",
"write controlword = 7",
"until statusword & 0x6F == 0x23 within 1 s",
"end",
"copy position actual -> target position",
"write controlword = 15",
"until statusword & 0x6F == 0x27 within 10 s",
"end",
]
undo = ["send 9 0 0", "send 10 0 0"]
[plans.follow-velocity]
source = "CiA 301 (7.5.2.36), CiA 402-2 (cyclic synchronous modes)"
steps = [
"require statusword & 0x0008 == 0 else The drive has a fault: see `fault`, take its cause away, then clear it",
"read target velocity",
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"send 0 128 0",
"end",
"end",
"send 6 1 0",
"write rpdo 1 transmission = 1",
"write rpdo 1 entries = 0",
"write rpdo 1 entry 1 = 0x60FF0020",
"write rpdo 1 entry 2 = 0x60400010",
"write rpdo 1 entries = 2",
"send 6 1 1",
"send 7 1 0",
"write tpdo 1 transmission = 1",
"write tpdo 1 entries = 0",
"write tpdo 1 entry 1 = 0x60410010",
"write tpdo 1 entry 2 = 0x606C0020",
"write tpdo 1 entries = 2",
"send 7 1 1",
"with interpolation period",
"write interpolation exponent = -3",
"write interpolation period = {period}",
"end",
"with sync period",
"write sync period = 0",
"with sync counter",
"ensure sync counter = 0",
"end",
"write sync period = {period}",
"end",
"with lost connection option",
"ensure lost connection option = 3",
"end",
"with consumer heartbeat",
"if consumer heartbeat == 0",
"send 8 150 0",
"end",
"end",
"write target velocity = 0",
"write mode = 9",
"until mode display == 9 within 1 s",
"send 0 1 0",
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"write controlword = 6",
"until statusword & 0x6F == 0x21 within 1 s",
"write controlword = 7",
"until statusword & 0x6F == 0x23 within 1 s",
"end",
"read position actual",
"write controlword = 15",
"until statusword & 0x6F == 0x27 within 10 s",
"end",
]
undo = ["send 9 0 0", "send 10 0 0"]
[plans.follow-torque]
source = "CiA 301 (7.5.2.36), CiA 402-2 (cyclic synchronous modes)"
steps = [
"require statusword & 0x0008 == 0 else The drive has a fault: see `fault`, take its cause away, then clear it",
"read rated torque",
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"send 0 128 0",
"end",
"end",
"send 6 1 0",
"write rpdo 1 transmission = 1",
"write rpdo 1 entries = 0",
"write rpdo 1 entry 1 = 0x60710010",
"write rpdo 1 entry 2 = 0x60400010",
"write rpdo 1 entries = 2",
"send 6 1 1",
"send 7 1 0",
"write tpdo 1 transmission = 1",
"write tpdo 1 entries = 0",
"write tpdo 1 entry 1 = 0x60410010",
"write tpdo 1 entry 2 = 0x60770010",
"write tpdo 1 entries = 2",
"send 7 1 1",
"with interpolation period",
"write interpolation exponent = -3",
"write interpolation period = {period}",
"end",
"with sync period",
"write sync period = 0",
"with sync counter",
"ensure sync counter = 0",
"end",
"write sync period = {period}",
"end",
"with lost connection option",
"ensure lost connection option = 3",
"end",
"with consumer heartbeat",
"if consumer heartbeat == 0",
"send 8 150 0",
"end",
"end",
"write target torque = 0",
"write mode = 10",
"until mode display == 10 within 1 s",
"send 0 1 0",
"unless statusword & 0x6F == 0x27",
"unless statusword & 0x6F == 0x07",
"write controlword = 6",
"until statusword & 0x6F == 0x21 within 1 s",
"write controlword = 7",
"until statusword & 0x6F == 0x23 within 1 s",
"end",
"read position actual",
"write controlword = 15",
"until statusword & 0x6F == 0x27 within 10 s",
"end",
]
undo = ["send 9 0 0", "send 10 0 0"]
[plans.unfollow]
source = "CiA 301, CiA 402-2"
steps = [
"send 6 1 0",
"with consumer heartbeat",
"send 9 0 0",
"end",
"with lost connection option",
"send 10 0 0",
"end",
]
[plans.prepare-to]
source = "CiA 301 (7.5.2.36), CiA 402-2"
steps = [
"use check-fault",
"send 6 1 0",
"write rpdo 1 transmission = 1",
"write rpdo 1 entries = 0",
"write rpdo 1 entry 1 = 0x60400010",
"write rpdo 1 entries = 1",
"send 6 1 1",
"write target position = {target}",
"write profile velocity = {velocity?}",
"write profile acceleration = {acceleration?}",
"write profile deceleration = {acceleration?}",
"write profile deceleration = {deceleration?}",
"write mode = 1",
"until mode display == 1 within 1 s",
"use power-up",
"unless controlword & 0x0110 == 0x0100",
"write controlword = 15",
"end",
"use free-handshake",
"send 1 2 0x3F",
]
undo = ["send 6 1 0", "write controlword = 0x010F"]
[plans.prepare-by]
source = "CiA 301 (7.5.2.36), CiA 402-2"
steps = [
"use check-fault",
"send 6 1 0",
"write rpdo 1 transmission = 1",
"write rpdo 1 entries = 0",
"write rpdo 1 entry 1 = 0x60400010",
"write rpdo 1 entries = 1",
"send 6 1 1",
"write target position = {target}",
"write profile velocity = {velocity?}",
"write profile acceleration = {acceleration?}",
"write profile deceleration = {acceleration?}",
"write profile deceleration = {deceleration?}",
"if controlword & 0x0100 != 0",
"write target velocity = 0",
"write mode = 3",
"until mode display == 3 within 1 s",
"end",
"write mode = 1",
"until mode display == 1 within 1 s",
"use power-up",
"unless controlword & 0x0110 == 0x0100",
"write controlword = 15",
"end",
"use free-handshake",
"send 1 2 0x7F",
]
undo = ["send 6 1 0", "write controlword = 0x010F"]
[plans.begin]
source = "CiA 301 (7.2.5)"
steps = [
"send 5 0 0",
]
[plans.begun]
source = "CiA 402-2"
steps = [
"until statusword & 0x1000 == 0x1000 within 1 s",
"write controlword = 15",
]
"##,
    ),
    (
        "syntron-ts-canopen",
        r##"[fragments]
check-ready = [
"require control mode == 20 else This control mode does not obey CANopen (2 is the factory's, pulses): set Fn_00 = 20",
"no-fault alarm code",
"send 0 1 0",
]
switch-on = [
"unless statusword & 0x6F == 0x07",
"write controlword = 6",
"until statusword & 0x6F == 0x21 within 1 s",
"write controlword = 7",
"until statusword & 0x6F == 0x23 within 1 s",
"end",
"write controlword = 15",
"until statusword & 0x6F == 0x27 within 10 s",
]
free-handshake = [
"unless statusword & 0x1000 == 0",
"await statusword & 0x1000 == 0 within 300 ms",
"unless statusword & 0x1000 == 0",
"copy position actual -> target position",
"write controlword = 0x3F",
"write controlword = 15",
"until statusword & 0x1000 == 0 within 1 s",
"write target position = {target}",
"end",
"end",
]
power-up = [
"unless statusword & 0x6F == 0x27",
"use switch-on",
"end",
]
[plans.enable]
source = "TS manual V2 §3.6.1"
steps = [
"use check-ready",
"unless statusword & 0x6F == 0x27",
"write target velocity = 0",
"write target torque = 0",
"use switch-on",
"end",
]
undo = ["write controlword = 0"]
[plans.disable]
source = "CiA 402-2"
steps = [
"write controlword = 0",
]
[plans.stop]
source = "CiA 402-2; TS manual V2 §3.6.1"
steps = [
"if statusword & 0x6F == 0x27",
"write controlword = 0x010F",
"end",
"write target velocity = 0",
"write target torque = 0",
"standstill within 10 s",
]
[plans.quick-stop]
source = "CiA 402-2"
steps = [
"write controlword = 2",
"standstill within 5 s",
]
[plans.clear]
source = "CiA 402-2"
steps = [
"if statusword & 0x0008 != 0",
"write controlword = 0",
"wait 20 ms",
"write controlword = 0x80",
"wait 20 ms",
"await statusword & 0x0008 == 0 within 300 ms",
"write controlword = 0",
"unless statusword & 0x0008 == 0",
"wait 200 ms",
"write controlword = 0x80",
"wait 200 ms",
"write controlword = 0",
"end",
"until statusword & 0x0008 == 0 within 2 s",
"end",
]
undo = ["write controlword = 0"]
[plans.velocity]
source = "TS manual V2 §3.6.1"
steps = [
"use check-ready",
"write profile acceleration = {acceleration? as time to 3000 rpm}",
"write profile deceleration = {deceleration? as time to 3000 rpm}",
"write target velocity = {velocity}",
"write mode = 3",
"until mode display == 3 within 1 s",
"use power-up",
"write controlword = 15",
]
undo = ["write target velocity = 0"]
[plans.torque]
source = "TS manual V2 §3.6.3"
steps = [
"use check-ready",
"write target torque = {torque}",
"write mode = 4",
"until mode display == 4 within 1 s",
"use power-up",
"write controlword = 15",
]
undo = ["write target torque = 0"]
[plans.move-to]
source = "TS manual V2 §3.6.2"
steps = [
"use check-ready",
"write target position = {target}",
"write profile velocity = 3000",
"write profile velocity = {velocity?}",
"write profile acceleration = {acceleration? as time to 3000 rpm}",
"write profile deceleration = {deceleration? as time to 3000 rpm}",
"if controlword & 0x0100 != 0",
"write target velocity = 0",
"write mode = 3",
"until mode display == 3 within 1 s",
"end",
"write mode = 1",
"until mode display == 1 within 1 s",
"use power-up",
"unless controlword & 0x0110 == 0x0100",
"write controlword = 15",
"end",
"use free-handshake",
"write controlword = 0x1F",
"until statusword & 0x1000 == 0x1000 within 1 s",
"write controlword = 0x0F",
]
undo = ["write controlword = 0x010F"]
[plans.move-by]
source = "TS manual V2 §3.6.2"
steps = [
"use check-ready",
"write target position = {target}",
"write profile velocity = 3000",
"write profile velocity = {velocity?}",
"write profile acceleration = {acceleration? as time to 3000 rpm}",
"write profile deceleration = {deceleration? as time to 3000 rpm}",
"if controlword & 0x0100 != 0",
"write target velocity = 0",
"write mode = 3",
"until mode display == 3 within 1 s",
"end",
"write mode = 1",
"until mode display == 1 within 1 s",
"use power-up",
"unless controlword & 0x0110 == 0x0100",
"write controlword = 15",
"end",
"use free-handshake",
"write controlword = 0x5F",
"until statusword & 0x1000 == 0x1000 within 1 s",
"write controlword = 0x4F",
]
undo = ["write controlword = 0x010F"]
[plans.home]
source = "TS manual V2 §3.6.4"
steps = [
"use check-ready",
"require homing method != 0 else Set the homing method first; 20 goes forward to the home switch",
"ensure write target = 1",
"write homing speed switch = {velocity?}",
"write mode = 6",
"until mode display == 6 within 1 s",
"use power-up",
"write controlword = 0x0F",
"write controlword = 0x5F",
"write controlword = 0x4F",
"unless homing method in 35",
"homed statusword & 0x3000 != 0 within 120 s",
"end",
"until statusword & 0x3000 != 0 within 120 s",
"require statusword & 0x2000 == 0 else Homing failed: look at switches, speeds and method",
]
undo = ["write controlword = 0x010F"]
"##,
    ),
    (
        "syntron-ts",
        r##"[fragments]
powered = ["require internal enable == 1 else The motor is off, as after a power-off: look at the drive's alarm and its supply, then enable the axis"]
[plans.enable]
source = "TS manual V2 §2.5, §2.6.2"
steps = [
"require control mode in 1 14 else This control mode does not obey Modbus (2 is the factory's, pulses): set Fn_00 = 1 for speed or Fn_00 = 14 for position",
"no-fault alarm code",
"ensure write target = 1",
"write internal speed = 0",
"write internal enable = 1",
]
undo = ["write internal enable = 0"]
[plans.disable]
source = "TS manual V2 §2.5"
steps = ["write internal enable = 0", "write internal speed = 0"]
[plans.stop]
source = "TS manual V2 §2.5, §2.6.2"
steps = [
"write internal speed = 0",
"write path stop = 1",
"until path state == 0 within 10 s",
"standstill within 10 s",
"write path stop = 0",
]
[plans.quick-stop]
source = "TS manual V2 §2.6.1"
steps = [
"write internal speed = 0",
"write stop setting = 1",
"write path stop = 1",
"until path state == 0 within 5 s",
"standstill within 5 s",
"write path stop = 0",
"write stop setting = 0",
]
[plans.clear]
source = "TS manual V2 §4"
steps = [
"require alarm code == 0 else The TS has no register that clears an alarm: take away the cause, then switch the drive off and on, hold SET on its panel for a second, or use its alarm-clear input",
]
[plans.velocity]
source = "TS manual V2 §2.5"
steps = [
"require control mode == 1 else Set Fn_00 = 1 (internal speed mode) first",
"no-fault alarm code",
"ensure write target = 1",
"write internal speed = {velocity}",
# A drive that was without supply since then has lost that speed, and is off.
"unless internal enable & 1 == 1",
"write internal enable = 1",
"write internal speed = {velocity}",
"end",
"require control mode == 1 else The drive lost its settings, as after a power-off: look at its supply, and store Fn_00 = 1 in its flash",
"use powered",
]
undo = ["write internal speed = 0", "write internal enable = 0"]
[plans.move-to]
source = "TS manual V2 §2.6.2"
steps = [
"require control mode == 14 else Set Fn_00 = 14 (internal position mode) first; a standard TS does not have it",
"no-fault alarm code",
"ensure write target = 1",
"read mechanics motor turns",
"read mechanics travel",
"write trigger source = 1",
"write path number = 32",
"write path number = {path?}",
"write path 32 definition 1 = 1002",
"write path 32 position = {target}",
"write path 32 speed = 300",
"write path 32 speed = {velocity?}",
"write path 32 s-time = 0",
"write path 32 acceleration time = 200",
"write path 32 acceleration time = {acceleration? as time to velocity or 300 rpm}",
"write path 32 deceleration time = 200",
"write path 32 deceleration time = {deceleration? as time to velocity or 300 rpm}",
"write path 32 delay = 0",
"write path 32 definition 2 = 1",
"write path trigger = 0",
"write path stop = 0",
"write internal enable = 1",
"require control mode == 14 else Another master changed Fn_00: set it to 14 again",
"require internal enable == 1 else The drive does not power its motor: look at its alarm",
"write path trigger = 1",
"require path trigger == 1 else The drive lost its settings, as after a power-off: it did not start",
"no-fault alarm code",
"write path trigger = 0",
"use powered",
]
undo = ["write path stop = 1", "write path trigger = 0"]
[plans.move-by]
source = "TS manual V2 §2.6.2"
steps = [
"require control mode == 14 else Set Fn_00 = 14 (internal position mode) first; a standard TS does not have it",
"no-fault alarm code",
"ensure write target = 1",
"read mechanics motor turns",
"read mechanics travel",
"write trigger source = 1",
"write path number = 32",
"write path number = {path?}",
"write path 32 definition 1 = 2",
"write path 32 position = {target}",
"write path 32 speed = 300",
"write path 32 speed = {velocity?}",
"write path 32 s-time = 0",
"write path 32 acceleration time = 200",
"write path 32 acceleration time = {acceleration? as time to velocity or 300 rpm}",
"write path 32 deceleration time = 200",
"write path 32 deceleration time = {deceleration? as time to velocity or 300 rpm}",
"write path 32 delay = 0",
"write path 32 definition 2 = 2001",
"write path trigger = 0",
"write path stop = 0",
"write internal enable = 1",
"require control mode == 14 else Another master changed Fn_00: set it to 14 again",
"require internal enable == 1 else The drive does not power its motor: look at its alarm",
"write path trigger = 1",
"require path trigger == 1 else The drive lost its settings, as after a power-off: it did not start",
"no-fault alarm code",
"write path trigger = 0",
"use powered",
]
undo = ["write path stop = 1", "write path trigger = 0"]
[plans.curve-to]
source = "TS manual V2 §2.6.2"
steps = [
"require control mode == 14 else Set Fn_00 = 14 (internal position mode) first; a standard TS does not have it",
"no-fault alarm code",
"ensure write target = 1",
"read mechanics motor turns",
"read mechanics travel",
"write trigger source = 1",
"write path number = 32",
"write path number = {path?}",
"write path 32 definition 1 = 1002",
"write path 32 position = {target}",
"write path 32 speed = 300",
"write path 32 speed = {velocity?}",
"write path 32 s-time = 0",
"write path 32 acceleration time = 200",
"write path 32 acceleration time = {acceleration? as time to velocity or 300 rpm}",
"write path 32 deceleration time = 200",
"write path 32 deceleration time = {deceleration? as time to velocity or 300 rpm}",
"write path 32 s-time = {jerk-time}",
"write path 32 delay = 0",
"write path 32 definition 2 = 1",
"write path trigger = 0",
"write path stop = 0",
"write internal enable = 1",
"require control mode == 14 else Another master changed Fn_00: set it to 14 again",
"require internal enable == 1 else The drive does not power its motor: look at its alarm",
"write path trigger = 1",
"require path trigger == 1 else The drive lost its settings, as after a power-off: it did not start",
"no-fault alarm code",
"write path trigger = 0",
"use powered",
]
undo = ["write path stop = 1", "write path trigger = 0"]
[plans.curve-by]
source = "TS manual V2 §2.6.2"
steps = [
"require control mode == 14 else Set Fn_00 = 14 (internal position mode) first; a standard TS does not have it",
"no-fault alarm code",
"ensure write target = 1",
"read mechanics motor turns",
"read mechanics travel",
"write trigger source = 1",
"write path number = 32",
"write path number = {path?}",
"write path 32 definition 1 = 2",
"write path 32 position = {target}",
"write path 32 speed = 300",
"write path 32 speed = {velocity?}",
"write path 32 s-time = 0",
"write path 32 acceleration time = 200",
"write path 32 acceleration time = {acceleration? as time to velocity or 300 rpm}",
"write path 32 deceleration time = 200",
"write path 32 deceleration time = {deceleration? as time to velocity or 300 rpm}",
"write path 32 s-time = {jerk-time}",
"write path 32 delay = 0",
"write path 32 definition 2 = 2001",
"write path trigger = 0",
"write path stop = 0",
"write internal enable = 1",
"require control mode == 14 else Another master changed Fn_00: set it to 14 again",
"require internal enable == 1 else The drive does not power its motor: look at its alarm",
"write path trigger = 1",
"require path trigger == 1 else The drive lost its settings, as after a power-off: it did not start",
"no-fault alarm code",
"write path trigger = 0",
"use powered",
]
undo = ["write path stop = 1", "write path trigger = 0"]
[plans.run-path]
source = "TS manual V2 §2.6.2"
steps = [
"require control mode == 14 else Set Fn_00 = 14 (internal position mode) first; a standard TS does not have it",
"no-fault alarm code",
"require path state == 0 else A path or homing runs: stop the axis first",
"ensure write target = 1",
"write trigger source = 1",
"write path number = {path}",
"write path trigger = 0",
"write path stop = 0",
"write internal enable = 1",
"require control mode == 14 else Another master changed Fn_00: set it to 14 again",
"require internal enable == 1 else The drive does not power its motor: look at its alarm",
"write path trigger = 1",
"require path trigger == 1 else The drive lost its settings, as after a power-off: it did not start",
"no-fault alarm code",
"write path trigger = 0",
"use powered",
]
undo = ["write path stop = 1", "write path trigger = 0"]
[plans.home]
source = "TS manual V2 §2.6.2"
steps = [
"require control mode == 14 else Set Fn_00 = 14 (internal position mode) first; a standard TS does not have it",
"require homing way > 9999 else Digit D of Fn_200 is 0, which homes nothing: set it; 20000 finds the home switch in reverse",
"no-fault alarm code",
"ensure write target = 1",
"write homing speed = {velocity?}",
"write trigger source = 1",
"write homing trigger = 0",
"write path stop = 0",
"write internal enable = 1",
"write homing trigger = 1",
"write homing trigger = 0",
"homed path state == 0 within 60 s",
"no-fault alarm code",
"use powered",
]
undo = ["write path stop = 1", "write homing trigger = 0"]
"##,
    ),
    (
        "technosoft-f514l",
        r##"[fragments]
powered = ["require status low & 0x8000 == 0x8000 else the motor is off: enable the axis first"]
start = [
"send 0 0x0108 0",
"require status low & 0x8000 == 0x8000 else the motor went off while it was commanded, and does not move: see the faults and the supply, enable the axis, and command it again",
]
target-here = [
"standstill within 2 s",
"if status low & 0x8000 == 0x8000",
"copy target position -> position command",
"end",
"unless status low & 0x8000 == 0x8000",
"copy actual position -> position command",
"end",
"send 3 0x5909 0xBFC18701",
"send 3 0x5909 0xFFFF2000",
"send 3 0x5909 0xFFFF4000",
]
[plans.enable]
source = "TML_LIB_light: set-up check, ENDINIT, AXISON, SRL bit 15; STA first, so that no older target is there"
steps = [
"require motion error & 0x0004 == 0 else the drive has no valid set-up table: download one with the vendor's set-up tool",
"send 0 0x0020 0",
"no-fault motion error & 0xBF2A",
"send 1 0x2CB2 0x0228",
"send 0 0x0102 0",
"until status low & 0x8000 == 0x8000 within 10 s",
]
undo = ["send 0 0x0002 0"]
[plans.disable]
source = "TML_LIB_light: AXISOFF"
steps = ["send 0 0x0002 0", "until status low & 0x8000 == 0 within 1 s"]
[plans.stop]
source = "TML_LIB_light: STOP, which brakes by CACC and holds"
steps = ["send 0 0x01C4 0", "standstill within 30 s"]
[plans.quick-stop]
source = "STOP; the language has no faster one that keeps control of the shaft"
steps = ["send 0 0x01C4 0", "standstill within 30 s"]
[plans.clear]
source = "TML_LIB_light: FAULTR; errors whose cause is still there come back"
steps = ["send 0 0x1C04 0", "no-fault motion error & 0x3F2A"]
[plans.velocity]
source = "TML_LIB_light: CACC, CSPD, MODE SP, TUM1, UPD"
steps = [
"use powered",
"write acceleration command = {acceleration?}",
"write speed command = {velocity}",
"send 3 0x5909 0xBBC18301",
"send 3 0x5909 0xFFFF4000",
"use start",
]
undo = ["send 0 0x01C4 0"]
[plans.move-to]
source = "TML_LIB_light: CPOS, CSPD, CACC, MODE PP, CPA, TUM1, UPD"
steps = [
"use powered",
"write acceleration command = {acceleration?}",
"write speed command = {velocity?}",
"write position command = {target}",
"send 3 0x5909 0xBFC18701",
"send 3 0x5909 0xFFFF2000",
"send 3 0x5909 0xFFFF4000",
"use start",
]
undo = ["send 0 0x01C4 0"]
[plans.torque]
source = "register map (MCR, EREFT) and the codes of MODE TES, EXTREF 0: torque by the line, in parts of the peak current. Not MODE TT, whose ramp turns the field by itself and leaves the shaft aside"
steps = [
"use powered",
"write external torque reference = {torque}",
"send 3 0x5909 0xB1C08100",
"send 3 0x5909 0xFF3F0000",
"use start",
]
undo = ["send 0 0x01C4 0"]
[plans.move-by]
source = "TML_LIB_light: CPOS, CSPD, CACC, MODE PP, CPR, TUM1, UPD; SRBL takes ACR bit 11 away, so that it counts from where the target is now"
steps = [
"use powered",
"write acceleration command = {acceleration?}",
"write speed command = {velocity?}",
"write position command = {target}",
"send 4 0x0912 0xF7FF0000",
"send 3 0x5909 0xBFC18701",
"send 3 0x5909 0xDFFF0000",
"send 3 0x5909 0xFFFF4000",
"use start",
]
undo = ["send 0 0x01C4 0"]
[plans.move-on]
source = "TML_LIB_light: as move-by, but SRBL ACR, 0FFFFh, 0800h: it counts from the last target, reached or not"
steps = [
"use powered",
"write acceleration command = {acceleration?}",
"write speed command = {velocity?}",
"write position command = {target}",
"send 4 0x0912 0xFFFF0800",
"send 3 0x5909 0xBFC18701",
"send 3 0x5909 0xDFFF0000",
"send 3 0x5909 0xFFFF4000",
"use start",
]
undo = ["send 0 0x01C4 0"]
[plans.curve-to]
source = "TML_LIB_light: CPOS, CSPD, CACC, TJERK, MODE PSC, CPA, TUM1, UPD; DER bits 8 and 9 tell when the drive would not"
steps = [
"use powered",
"require status low & 0x0400 == 0x0400 else an S-curve begins at rest: wait for the motion to end, or stop the axis",
"require detailed error & 0x0300 == 0 else the drive still tells of an S-curve that it refused before: clear its faults",
"write acceleration command = {acceleration?}",
"write speed command = {velocity?}",
"write jerk time = {jerk-time}",
"write position command = {target}",
"send 3 0x5909 0xFFC18707",
"send 3 0x5909 0xFFFF2000",
"send 3 0x5909 0xFFFF4000",
"use start",
"require detailed error & 0x0300 == 0 else the drive refused the S-curve: choose another time, speed or acceleration; clear its faults",
]
undo = ["send 0 0x01C4 0"]
[plans.curve-by]
source = "TML_LIB_light: as curve-to, with CPR; ACR bit 11 as in move-by"
steps = [
"use powered",
"require status low & 0x0400 == 0x0400 else an S-curve begins at rest: wait for the motion to end, or stop the axis",
"require detailed error & 0x0300 == 0 else the drive still tells of an S-curve that it refused before: clear its faults",
"write acceleration command = {acceleration?}",
"write speed command = {velocity?}",
"write jerk time = {jerk-time}",
"write position command = {target}",
"send 4 0x0912 0xF7FF0000",
"send 3 0x5909 0xFFC18707",
"send 3 0x5909 0xDFFF0000",
"send 3 0x5909 0xFFFF4000",
"use start",
"require detailed error & 0x0300 == 0 else the drive refused the S-curve: choose another time, speed or acceleration; clear its faults",
]
undo = ["send 0 0x01C4 0"]
[plans.home]
source = "by the host: what the drive's own homing functions are depends on its set-up (`CALLS`, `FUNCTION`). It turns at the homing speed to a limit switch, stops, lets the shaft settle, and calls that place zero"
steps = [
"use powered",
"write homing speed = {velocity?}",
"require homing speed != 0 else set the homing speed first: slow, its sign tells to which limit switch",
"require motion error & 0x00C0 == 0 else a limit switch is closed already: move the axis off it first",
"copy homing speed -> speed command",
"send 3 0x5909 0xBBC18301",
"send 3 0x5909 0xFFFF4000",
"use start",
"homed motion error & 0xBFEA != 0 within 60 s",
"no-fault motion error & 0xBF2A",
"send 0 0x01C4 0",
"standstill within 30 s",
"wait 200 ms",
"send 2 0x8400 0",
]
undo = ["send 0 0x01C4 0"]
[plans.give-time]
source = "manual chapter 5, example 4: SETSYNC makes it master, which synchronises so often"
steps = ["send 2 0x1404 {period} like absolute time"]
[plans.withhold-time]
source = "manual chapter 5, example 4: SETSYNC 0"
steps = ["send 2 0x1404 0"]
[plans.send-position]
source = "labelled frames of SGM and RGM; header of TML_LIB (SLAVEID; OSR bit 15 clear: the measured position)"
steps = [
"use target-here",
"send 4 0x0302 0x7FFF0000",
"send 3 0x5909 0xFFFF0800",
"send 0 0x0108 0",
]
[plans.withhold-position]
source = "labelled frames of RGM, which takes effect at UPD"
steps = [
"use target-here",
"send 3 0x5909 0xF7FF0000",
"send 0 0x0108 0",
]
[plans.follow-gear]
source = "labelled frames and the header of TML_LIB: GEAR, EXTREF 0, MODE GS, TUM1, UPD; SRH bit 12"
steps = [
"use powered",
"send 3 0x5909 0xFF3F0000",
"send 3 0x5909 0xB7C58705",
"send 3 0x5909 0xFFFF4000",
"use start",
"until status high & 0x1000 == 0x1000 within 1 s",
]
undo = ["send 0 0x01C4 0"]
[plans.follow-cam]
source = "labelled frames and the header of TML_LIB: CAMSTART, ACR bit 12 clear (relative), EXTREF 0, MODE CS, TUM1, UPD; SRH bit 14"
steps = [
"use powered",
"write cam input factor = 65536",
"write cam output factor = 65536",
"write cam offset = 0",
"send 4 0x0912 0xEFFF0000",
"send 3 0x5909 0xFF3F0000",
"send 3 0x5909 0xB7C68706",
"send 3 0x5909 0xFFFF4000",
"use start",
"until status high & 0x4000 == 0x4000 within 1 s",
]
undo = ["send 0 0x01C4 0"]
[plans.store]
source = "TML_LIB_light: SAVE"
steps = ["send 0 0x1C08 0"]
"##,
    ),
];
