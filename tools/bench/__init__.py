"""The benchmarks: `./run bench` or `python -m tools.bench`."""
