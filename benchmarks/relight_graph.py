"""Time the transport product as a graph: onnxruntime on a processor and onnxruntime-web in Chromium.

    python benchmarks/relight_graph.py [--pixels 131072] [--coefficients 25]

One thread for each, random values, the shortest of five runs. The browser's answer is compared with the
processor's. Half of a 512 x 512 picture by default: the pixels travel to the browser as text.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import numpy as np
import onnxruntime
from flashcache.export.onnx import WeightFile
from flashcache.export.relight_graph import INDIRECT_COEFFICIENTS, relight_graph
from support.engine_page import engine_page

NUM_VISIBILITY = 16
TURNS = 5


def random_inputs(num_pixels: int, num_direct: int) -> dict[str, np.ndarray]:
    """Return random inputs of the graph, float32 [pixel, width], and the light's harmonics."""
    rng = np.random.default_rng(0)
    widths = {
        "transfer_direct": num_direct,
        "transfer_indirect": 3 * INDIRECT_COEFFICIENTS,
        "visibility": NUM_VISIBILITY,
        "sh_reflect": NUM_VISIBILITY,
        "albedo_diffuse": 3,
        "spec_prefiltered": 3,
    }
    found = {name: rng.random((num_pixels, width), np.float32) for name, width in widths.items()}
    return {**found, "light_sh": rng.random((num_direct, 3), np.float32)}


def main() -> None:
    """Print milliseconds per picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--pixels", type=int, default=131_072)
    parser.add_argument("--coefficients", type=int, default=25, help="of direct transfer")
    arguments = parser.parse_args()
    inputs = random_inputs(arguments.pixels, arguments.coefficients)
    with tempfile.TemporaryDirectory() as name:
        folder, bundle = Path(name), Path(name) / "bundle"
        (bundle / "models").mkdir(parents=True)
        path = bundle / "models" / "relight.onnx"
        path.write_bytes(
            relight_graph(arguments.coefficients, NUM_VISIBILITY, WeightFile(), {}).SerializeToString()
        )
        (bundle / "models" / "weights.bin").write_bytes(b"")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        (wanted,) = session.run(None, inputs)
        native = []
        for _ in range(TURNS):
            started = time.perf_counter()
            session.run(None, inputs)
            native.append(1e3 * (time.perf_counter() - started))
        with engine_page(bundle, folder / "browser") as page:
            page.open("relight", "models/relight.onnx", "wasm")
            some = {key: values if key == "light_sh" else values[:4096] for key, values in inputs.items()}
            error = float(np.abs(page.run("relight", some)["radiance"] - wanted[:4096]).max())
            browser = page.time("relight", inputs, TURNS)
    print(f"{arguments.pixels} pixels, {arguments.coefficients} coefficients of direct transfer")
    print("| runtime | ms |\n| --- | --- |")
    for title, shortest in (("onnxruntime", min(native)), ("onnxruntime-web, WASM", browser)):
        print(f"| {title} | {shortest:.1f} |")
    print(f"largest difference of 4096 pixels: {error:.1e}")


if __name__ == "__main__":
    main()
