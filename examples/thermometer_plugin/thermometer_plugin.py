from pathlib import Path

from robot_runner import plugins as rr


class Thermometer(rr.Profiler):
    """Measures how warm this machine is, as Linux tells it."""

    measures = [rr.Measure("Temperature", "°C", "Mean temperature of the processor.", over=rr.Over.MEAN)]
    needs = "Linux with a thermal zone."
    sampler = None

    def __init__(self, *, path: str = "/sys/class/thermal/thermal_zone0/temp", name: str | None = None) -> None:
        super().__init__(name=name)
        self.path = Path(path)

    def check(self, circumstances: rr.Circumstances) -> list[rr.Finding]:
        problem = f"there is no file {self.path}"
        finding = rr.Finding.error(f"plugin {self.name}", problem, "Name an existing file: path='...'.")
        return [] if self.path.is_file() else [finding]

    def read(self) -> float:
        return int(self.path.read_text()) / 1000

    def start_measurement(self, context: rr.RobotRunnerContext) -> None:
        self.sampler = rr.PeriodicSampler(self.read, rate=5.0, clock=context.clock)
        self.sampler.start()

    def stop_measurement(self, context: rr.RobotRunnerContext) -> None:
        if self.sampler is not None:  # also called where the measurement never started
            self.sampler.stop()

    def populate_run_data(self, context: rr.RobotRunnerContext) -> None:
        samples = self.sampler.stop()  # it has stopped: this only returns its samples
        columns = [rr.Column("time_s", samples.times), rr.Column("temperature_C", samples.readings, "%.2f")]
        rr.write_samples(context.raw_data_folder / "samples.csv", columns)
        rr.report_quality(context, samples.over(context.window).quality(), context.window, sampled=samples.window)
        rr.publish_measures(context, self.measures, self.evaluate, times=samples.times)

    def evaluate(self, window: rr.Window) -> dict[str, float | None]:
        samples = self.sampler.stop().over(window)
        return {"Temperature": rr.mean(rr.cut(samples.series(), window))} if samples.quality().is_sufficient else {}
