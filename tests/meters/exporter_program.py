"""A real Prometheus exporter: prometheus-client's own server in a process of its own, told by lines what to show.

`inc NAME AMOUNT` and `set NAME VALUE`; it says its port first, and `done` after each line.
"""

from __future__ import annotations

import sys

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server

registry = CollectorRegistry()
joules = Counter("supply_energy_joules", "Energy.", registry=registry)
watts = Gauge("supply_power_watts", "Power.", registry=registry)
packets = Counter("packets", "By interface.", ["interface"], registry=registry)
load = Gauge("core_load_percent", "By core.", ["core"], registry=registry)
latency = Histogram("latency_seconds", "Of answers.", registry=registry)
legacy = Gauge("legacy_total", "A gauge with a counter's name.", registry=registry)

for interface in ("eth0", "wlan0"):
    packets.labels(interface).inc(100)
for core in ("0", "1"):
    load.labels(core).set(20 + 40 * int(core))
watts.set(8)
joules.inc(1000)

server, thread = start_http_server(0, addr="127.0.0.1", registry=registry)
print(server.server_address[1], flush=True)  # noqa: T201 - its way to speak
for line in sys.stdin:
    verb, name, amount = line.split()
    metric = {"joules": joules, "watts": watts}.get(name)
    if name.startswith("core"):
        metric = load.labels(name.removeprefix("core"))
    elif name.endswith("0"):
        metric = packets.labels(name)
    if verb == "set":
        metric.set(float(amount))
    elif verb == "inc":
        metric.inc(float(amount))
    elif verb == "observe":
        latency.observe(float(amount))
    elif verb == "reset":
        joules.reset()
    print("done", flush=True)  # noqa: T201 - as above
server.shutdown()
server.server_close()
