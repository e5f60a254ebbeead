"""Small ASCET projects for the tests: a library, a battery with its sensor, tasks at several periods, a vehicle."""

import numpy as np

from kennfeld.graph.interpreter import evaluate
from tests.clocks import even_clock

LIBRARY = {
    "Lib/Lib/Time/DeltaTime.esdl": """package Lib.Time;
type TimeType is real 0.0 .. 100.0;
singleton class DeltaTime { @dT public static TimeType deltaT = 0.0; }
""",
    "Lib/Lib/Dynamics/Integrator.esdl": """package Lib.Dynamics;
import Lib.Time.DeltaTime;
/** Time discrete integrator. */
class Integrator {
	real memory = 0.0;
	public void compute(real in val, real in gain, real in low, real in high) {
		memory = max(min(memory + val * DeltaTime.deltaT * gain, high), low);
	}
	@no_side_effect public real value() { return memory; }
	public void reset(real in start) { memory = start; }
}
""",
    "Lib/Lib/Dynamics/LowPass.esdl": """package Lib.Dynamics;
import Lib.Time.DeltaTime;
class LowPass {
	real state = 0.0;
	public real compute(real in val, real in T) {
		state = state + (val - state) * DeltaTime.deltaT / (T + DeltaTime.deltaT);
		return state;
	}
}
""",
    "Lib/Lib/Logic/EdgeRising.esdl": """package Lib.Logic;
class EdgeRising {
	boolean edge = false;
	boolean previous = true;
	public void compute(boolean in signal) { edge = signal && !previous; previous = signal; }
	public boolean value() { return edge; }
}
""",
    "Lib/Lib/Math/Mathematics.esdl": """package Lib.Math;
@include("math.h")
stateless class Mathematics {
	@symbol("exp") extern public real exp(real val);
	@symbol("sqrt") extern public real sqrt(real val);
	@symbol("atan2") extern public real atan2(real y, real x);
	representation R32 { @symbol("expf") represent exp; represent exp.val using { datatype = float32; }; }
}
""",
}

BATTERY = {
    "Battery/Cell/Types.esdl": """package Cell;
type CurveOfReal is table real -> real;
type MapOfReal is table real, real -> real;
type Volt is real 0.0 .. 5.0 delta 0.001953125;
unit A;
""",
    "Battery/Signals/Messages.esdl": """package Signals;
import Cell.A;
data interface Messages {
	A current = 0.0;
	real ambient = 293.0;
	real voltage = 0.0;
	real charge = 0.0;
	real estimate = 0.0;
	real temperature = 293.0;
}
""",
    "Battery/Cell/Plant.esdl": """package Cell;
import Signals.Messages;
import Lib.Dynamics.Integrator;
import Lib.Math.Mathematics;

singleton class Plant
reads Messages.current, Messages.ambient
writes Messages.voltage, Messages.charge, Messages.temperature {
	sysconst real POWER = -1.5;
	Integrator heat;
	Integrator load;
	Mathematics mathematics;
	real lost;
	real leakage;
	/** heat capacity */
	characteristic real C_heat = 2.73;
	characteristic real C_damping = 1.7;
	characteristic real T0 = 20.0;
	characteristic real U0 = 1.55;
	characteristic real R_leak = 1200.0;
	characteristic real R_inner = 0.08;
	characteristic real I_leak = 5E-7;
	characteristic real capacity = 25.0;
	characteristic real start = 41.5;
	characteristic MapOfReal leak[4][3] = {
		{ -20.0, 0.0, 25.0, 60.0 },
		{ 0.0, 50.0, 100.0 },
		{
			{ 2.4, 1.5, 1.3 },
			{ 1.8, 1.1, 0.9 },
			{ 1.2, 0.5, 0.2 },
			{ 1.1, 0.3, 0.0 }
		}
	};

	@thread
	public void calc() {
		lost = POWER * Messages.current;
		heat.compute(lost + C_damping * (Messages.ambient - (heat.value() / C_heat + T0)), 1.0, -1000.0, 1000.0);
		Messages.temperature = heat.value() / C_heat + T0;
		{
			leakage = leak.getAt(Messages.temperature, start + load.value() / capacity) * R_leak + R_leak;
		}
		Messages.voltage = (U0 - Messages.current * R_inner) * (leakage / (R_inner + leakage));
		load.compute(
			(Messages.current - mathematics.exp((Messages.voltage - 1.5) / 0.05) * I_leak)
				* (1.0 - (start + load.value() / capacity) / 100.0),
			1.0, -1041.325, 1458.675);
		Messages.charge = start + load.value() / capacity;
	}

	@thread
	public void init() {
		heat.reset((Messages.ambient - T0) * C_heat);
	}
}
""",
    "Battery/Cell/Sensor.esdl": """package Cell;
import Signals.Messages;

singleton class Sensor
reads Messages.voltage, Messages.temperature
writes Messages.estimate {
	Accu accu = Accu.Old();
	@thread
	public void calc() { Messages.estimate = accu.charge(Messages.voltage, Messages.temperature); }
}
""",
    "Battery/Cell/Accu.esdl": """package Cell;
class Accu {
	characteristic Volt base = 1.4;
	characteristic real gain = 0.001;
	characteristic real inverse <- "0.1 / x", x = gain;
	characteristic CurveOfReal shift[5] = { { 0.0, 20.0, 30.0, 40.0, 60.0 }, { 0.17, 0.15, 0.15, 0.16, 0.19 } };

	public real charge(real in U, real in T) {
		return max(min((max(min(U + shift.getAt(T), 2.5), 0.5) - base) * inverse, 100.0), 0.0);
	}
	public initializer Old() { base = 1.2; gain = 0.0006; }
}
""",
    "Battery/Battery.app": """application { class Cell.Plant class Cell.Sensor }
schedule {
	startup { process Cell.Plant.init }
	shutdown { }
	task Task_10ms priority 0 period 10ms delay 0ms {
		process Cell.Plant.calc
		process Cell.Sensor.calc
	}
}
""",
}

TASKS = {
    "Plant/Bus/Messages.esdl": """package Bus;
data interface Messages {
	real demand = 0.0;
	real fast = 1.0;
	real slow = 2.0;
	real late = 0.0;
}
""",
    "Plant/Car/Fast.esdl": """package Car;
import Bus.Messages;
import Lib.Time.DeltaTime;
singleton class Fast reads Messages.demand, Messages.slow writes Messages.fast, Messages.late {
	characteristic real gain = 3.0;
	real start = 0.0;
	@thread public void init() { start = Messages.demand; }
	@thread public void calc() {
		Messages.fast = Messages.fast + (gain * Messages.demand - Messages.slow + start) * DeltaTime.deltaT;
	}
	@thread public void rare() { Messages.late = Messages.late + Messages.fast + DeltaTime.deltaT; }
}
""",
    "Plant/Car/Slow.esdl": """package Car;
import Bus.Messages;
import Lib.Time.DeltaTime;
singleton class Slow reads Messages.fast writes Messages.slow {
	characteristic real weight = 0.25;
	@thread public void calc() {
		Messages.slow = Messages.slow + weight * (Messages.fast - Messages.slow) + DeltaTime.deltaT;
	}
	@thread public real twice() { return Messages.fast * 2.0; }
}
""",
    "Plant/Plant.app": """application { class Car.Fast class Car.Slow }
schedule {
	startup { process Car.Fast.init }
	shutdown { }
	task Slow_30ms priority 1 period 30ms delay 0ms { process Car.Slow.calc }
	task Fast_10ms priority 0 period 10ms delay 0ms { process Car.Fast.calc }
	task Late priority 2 period 40ms delay 20ms { process Car.Fast.rare process Car.Slow.twice }
	task Key priority 0 { process Car.Fast.rare }
	task Idle priority 3 period 7ms { }
}
""",
}

VEHICLE = """package Car;
import Lib.Dynamics.Integrator;
import Lib.Logic.EdgeRising;
import Lib.Math.Mathematics;

type ForceCurve is table real -> real;

class Vehicle {
	real slope = 0.0;
	boolean hold = false;
	real brake = 0.0;
	real velocity = 0.0;
	real engine = 0.0;
	real air = 0.0;
	Mathematics mathematics;
	EdgeRising edge;
	Integrator speed;
	characteristic real mass = 1700.0;
	characteristic real area = 1.45;
	characteristic real steepness = 32.0;
	characteristic ForceCurve engineForce[5] = {
		{ 0.0, 0.2, 0.5, 0.8, 1.0 }, { 0.0, 1500.0, 12000.0, 18600.0, 19000.0 }
	};
	characteristic ForceCurve brakeForce[4] = { { 0.0, 0.1, 0.5, 1.0 }, { 0.0, 18000.0, 80.0E3, 100.0E3 } };

	public real calc(real in accelerator, real in wind, real in road, real in pedal) {
		boolean zeroCross;
		real before;
		if (pedal < 0.05) {
			hold = false;
		}
		if (edge.value() && (accelerator <= 0.01)) {
			hold = true;
		}
		if (hold) {
			speed.reset(0.0);
		} else {
			speed.compute((((engine - air) - brake) / mass) + slope, 1.0, -100.0, 100.0);
		}
		slope = mathematics.sqrt((if(abs(road) <= 0.0001) then 0.0
			else(steepness / (((1.0 / road) * (1.0 / road)) + 1.0))))
			* 9.81 * (if(road < 0.0) then 1.0 else -1.0);
		before = velocity;
		zeroCross = ((before * velocity) <= 0.0);
		brake = brakeForce.getAt(pedal) * (if zeroCross then 0.0 else(if(velocity < 0.0) then -1.0 else 1.0));
		edge.compute(zeroCross);
		engine = engineForce.getAt(accelerator);
		air = (wind + velocity) * (wind + velocity) * area * (if((wind + velocity) < 0.0) then -1.0 else 1.0);
		velocity = speed.value();
		return velocity;
	}
}
"""

MACHINE = """type States is enum { Idle, Ready, Busy, Slow };
class C {
	@set private boolean go = false;
	@set private real level = 0.0;
	@get private real trace = 0.0;
	real log(real in digit) { trace = trace * 10.0 + digit; return trace; }
	public void step() triggers Machine;
	public States now() { return Machine.getState(); }
	statemachine Machine using States {
		start Idle;
		state Idle {
			entry { log(1.0); }
			static { trace = 0.0; }
			transition go to Busy { log(2.0); };
		}
		state Busy {
			entry { log(3.0); }
			static { log(4.0); }
			exit { log(5.0); }
			transition !go to Idle;
			start Ready;
			state Ready { entry { log(6.0); } exit { log(7.0); } transition level > 0.0 to choose; }
			state Slow { entry { log(8.0); } static { log(9.0); } transition level < 0.0 to Ready; }
			junction choose { transition level > 5.0 to Idle; transition level > 2.0 to Slow; }
		}
	}
}
"""


def write_project(folder, files):
    """Write the files of a project, and the library beside it."""
    for name, text in {**LIBRARY, **files}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def class_model(folder, text, **options):
    """The model of a class in a file of its own."""
    write_project(folder, {"Own/Own/Own.esdl": f"package Own;\n{text}"})
    from kennfeld.importers.ascet.importing import esdl

    return esdl(folder / "Own/Own/Own.esdl", **options)


def run(model, columns=None, dt=0.1, parameters=None, samples=None):
    """The values of all nodes over the samples, by name."""
    arrays = {name: np.asarray(column, dtype=float) for name, column in (columns or {}).items()}
    count = samples or next(iter(arrays.values())).size
    step = model.step or dt
    return evaluate(model.graph, {**arrays, **even_clock(step, count)}, parameters or model.values)
