import json
import subprocess
import sys

HEAVY = ["torch", "lightning", "mlflow", "mujoco", "matplotlib", "h5py"]

#: Prints the heavy packages that an import loads, and its CPU seconds.
PROBE = f"""
import json, sys, time
before = time.process_time()
import hdsp
seconds = time.process_time() - before
print(json.dumps([[name for name in {HEAVY} if name in sys.modules], seconds]))
"""


def probe():
    answer = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=True, timeout=120)
    return json.loads(answer.stdout)


def test_importing_the_package_is_quick_and_brings_nothing_heavy():
    runs = [probe() for _ in range(4)]
    assert [loaded for loaded, _ in runs] == [[]] * 4
    assert min(seconds for _, seconds in runs) < 1.0  # CPU time does not depend on other processes


def test_the_public_names_are_there():
    import hdsp

    assert all(hasattr(hdsp, name) for name in hdsp.__all__)
    assert {"HeightMap", "Planner", "Plan", "Robot", "InputError", "Status"} <= set(hdsp.__all__)
