from pathlib import Path

from robot_runner.plugins import (
    Circumstances,
    Column,
    Finding,
    Measure,
    Over,
    PeriodicSampler,
    Profiler,
    RobotRunnerContext,
    Window,
    cut,
    mean,
    publish_measures,
    report_quality,
    write_samples,
)


class Thermometer(Profiler):
    """Measures how warm this machine is, as Linux tells it."""

    measures = (
        Measure("Temperature", "°C", "Temperature of the processor, mean over the measured window.", over=Over.MEAN),
    )
    needs = "Linux with a thermal zone."
    sampler = None

    def __init__(self, *, path: str = "/sys/class/thermal/thermal_zone0/temp", name: str | None = None) -> None:
        super().__init__(name=name)
        self.path = Path(path)

    def check(self, circumstances: Circumstances) -> list[Finding]:
        finding = Finding.error(f"plugin {self.name}", f"there is no file {self.path}", "Name one that is: path='...'.")
        return [] if self.path.is_file() else [finding]

    def read(self) -> float:
        return int(self.path.read_text()) / 1000

    def start_measurement(self, context: RobotRunnerContext) -> None:
        self.sampler = PeriodicSampler(self.read, rate=5.0, clock=context.clock)
        self.sampler.start()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        if self.sampler is not None:  # also called where the measurement never started
            self.sampler.stop()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        samples = self.sampler.stop()  # it has stopped: this only returns its samples
        columns = [Column("time_s", samples.times), Column("temperature_C", samples.readings, "%.2f")]
        write_samples(context.raw_data_folder / "samples.csv", columns)
        report_quality(context, samples.over(context.window).quality(), context.window, sampled=samples.window)
        publish_measures(context, self.measures, self.evaluate)

    def evaluate(self, window: Window) -> dict[str, float | None]:
        samples = self.sampler.stop().over(window)
        return {"Temperature": mean(cut(samples.series(), window))} if samples.quality().is_sufficient else {}
