"""Links to the embedded robot besides its topics: its meter's serial line or terminal, and its on-board computer."""

from __future__ import annotations

import os
import select
import tempfile
import tty
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

from robot_runner.core.errors import LinkError
from robot_runner.measuring.host import UtilisationSample
from robot_runner.measuring.serial_line import SIMULATED_PORT, Chunk
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND, SimulatedClock, Ticker
from robot_runner.simulator.simulated_turtlebot3 import SimulatedTurtlebot3, Simulation

_SECOND_NS = 1_000_000_000
_HIGHEST_RATE = STEPS_PER_SECOND
#: The period of samples for live displays, simulated s: a mission of 95 s is over in a second or two.
_TOLD_EVERY = 0.5


class SimulatedSerialLine:
    """The serial line of a robot's power meter, which is switched on when the line is opened.

    Each sample comes in its own chunk, stamped with the simulation's time; a hello comes with the sample after it.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> simulation = Simulation(seed=1)
        >>> line = SimulatedSerialLine(simulation)
        >>> simulation.clock.sleep(0.1)
        >>> line.drain()[0].data[:4].hex()
        'a55a120c'
        >>> line.close()
        >>> simulation.close()
    """

    is_simulated = True

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._meter = simulation.turtlebot3(namespace).open_power_meter()
        self._is_closed = False

    def drain(self) -> list[Chunk]:
        """Return all chunks since the last call, oldest first; raise a `LinkError` if the line was closed."""
        self._check_open()
        return self._meter.arrived()

    def write(self, data: bytes) -> None:
        """Send bytes to the meter; raise a `LinkError` if the line was closed."""
        self._check_open()
        self._meter.write(data)

    def close(self) -> None:
        """Close the line; closing twice does nothing."""
        self._is_closed = True

    def _check_open(self) -> None:
        if self._is_closed:
            fix = "Drain it before it is closed."
            raise LinkError("the line was closed", where="the simulated power meter", fix=fix)


class SimulatedUtilisationSampler:
    """A sampler on the on-board computer of a robot, started by its constructor."""

    def __init__(self, robot: SimulatedTurtlebot3, clock: SimulatedClock, rate: float) -> None:
        self._robot = robot
        self._clock = clock
        self._rate = rate
        self._started_ns = clock.now_ns
        self._also_ns: list[int] = []
        self._ticker: Ticker | None = None
        self._samples: list[UtilisationSample] | None = None

    def tell(self, on_sample: Callable[[Callable[[], UtilisationSample]], None]) -> None:
        """Call `on_sample` periodically with a function for the current sample: all others are made at the end."""
        self._ticker = self._clock.call_every(_TOLD_EVERY, lambda: on_sample(self._latest))

    def _latest(self) -> UtilisationSample:
        now_ns = self._clock.now_ns
        since_ns = max(self._started_ns, now_ns - round(_TOLD_EVERY * _SECOND_NS))
        return self._robot.utilisation(start_ns=since_ns, stop_ns=now_ns, rate=1 / _TOLD_EVERY, also_ns=[now_ns])[-1]

    def take_now(self) -> None:
        """Take one more sample at once, out of turn."""
        self._also_ns.append(self._clock.now_ns)

    def stop(self) -> list[UtilisationSample]:
        """End sampling and return the samples, oldest first; a second call returns the same."""
        if self._ticker is not None:
            self._ticker.close()
        if self._samples is None:
            stop_ns = self._clock.now_ns
            self._samples = self._robot.utilisation(
                start_ns=self._started_ns, stop_ns=stop_ns, rate=self._rate, also_ns=self._also_ns
            )
        return list(self._samples)


class SimulatedHost:
    """The on-board computer of a robot of a simulation.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> simulation = Simulation(seed=1)
        >>> sampler = SimulatedHost(simulation).sample_utilisation(10)
        >>> simulation.clock.sleep(2.0)
        >>> len(sampler.stop())
        20
        >>> simulation.close()
    """

    is_simulated = True

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._robot = simulation.turtlebot3(namespace)
        self._clock = simulation.clock
        self._samplers = ExitStack()
        self._is_closed = False

    def sample_utilisation(self, rate: float) -> SimulatedUtilisationSampler:
        """Start sampling CPU and memory utilisation `rate` times a second, 200 at most.

        Raises:
            LinkError: the rate is out of range, or the link was closed.
        """
        if self._is_closed:
            fix = "Use it before the run ends."
            raise LinkError("the link was closed", where="the simulated on-board computer", fix=fix)
        if not 0 < rate <= _HIGHEST_RATE:
            fix = f"Give a rate above 0 and up to {_HIGHEST_RATE} Hz."
            raise LinkError(f"the sample rate is {rate!r} Hz", where="the simulated on-board computer", fix=fix)
        sampler = SimulatedUtilisationSampler(self._robot, self._clock, rate)
        self._samplers.callback(sampler.stop)
        return sampler

    def close(self) -> None:
        """End all samplers; closing twice does nothing."""
        self._is_closed = True
        self._samplers.close()


_READ_SIZE = 4096


class MeterTerminal:
    """A pseudo-terminal with a robot's meter, which is switched on by each opening, as an Arduino is reset.

    Bytes that are not read in time are lost, as on a serial line. The name of its `port` shows that it is simulated.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> terminal = MeterTerminal(Simulation(seed=1))
        >>> terminal.port.name
        'simulated-ina219'
        >>> terminal.close()
    """

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._simulation = simulation
        self._namespace = namespace
        self._line: SimulatedSerialLine | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="robot-runner-")
        self._device, port = os.openpty()
        tty.setraw(port)
        self.port = Path(self._folder.name) / SIMULATED_PORT
        self.port.symlink_to(os.ttyname(port))
        os.close(port)  # from now on the device gets a hang-up while the port is not open
        os.set_blocking(self._device, False)
        self._hang_up = select.poll()
        self._hang_up.register(self._device, 0)

    def exchange(self) -> None:
        """Deliver the meter's bytes so far, and take those that were sent to it."""
        if self._hang_up.poll(0):
            self._line = None
            return
        if self._line is None:
            self._line = SimulatedSerialLine(self._simulation, namespace=self._namespace)
        with suppress(OSError):  # there is nothing to read, or the port was just closed
            self._line.write(os.read(self._device, _READ_SIZE))
        with suppress(OSError):  # earlier bytes were not read
            for chunk in self._line.drain():
                os.write(self._device, chunk.data)

    def enter(self, simulation: Simulation) -> None:
        """Switch to the meter of this simulation, which starts as after a reset."""
        self._simulation = simulation
        self._line = None

    def close(self) -> None:
        """Remove the port; closing twice does nothing."""
        if self._device >= 0:
            os.close(self._device)
            self._device = -1
            self._folder.cleanup()
