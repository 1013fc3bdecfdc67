"""Compile everything that numba compiles, for this processor: a short training and one picture.

    .venv/bin/python scripts/compile_kernels.py

Compiled code is kept beside its source, or in NUMBA_CACHE_DIR, and compiled anew when that changes. Without
this the first training on a machine takes a minute longer.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

SCENE = Path(__file__).parent.parent / "tests" / "data" / "still_life"
FEW_STEPS = {
    "stage_one.num_steps": "80",  # Without a surface there would be no bundle.
    "stage_two.num_steps": "4",
    "stage_two.warmup_steps": "2",
    "stage_two.distil.num_steps": "2",
    "evaluation.num_views": "1",
}


def main() -> None:
    """Train and relight in a temporary folder."""
    print("compiling for this processor, once: about a minute", flush=True)
    lambent = [sys.executable, "-m", "lambent"]
    with tempfile.TemporaryDirectory() as folder:
        run, light = Path(folder) / "run", SCENE / "envmaps" / "studio.hdr"
        train = [*lambent, "train", str(SCENE), "-o", str(run), "--preset", "tiny"]
        train += [word for name, value in FEW_STEPS.items() for word in ("--set", f"{name}={value}")]
        relight = [*lambent, "relight", str(run / "bundle"), "--env", str(light), "--turntable", "1"]
        relight += ["--spp", "4", "-o", str(Path(folder) / "pictures")]
        for command in (train, relight):
            done = subprocess.run(
                command, capture_output=True, text=True, env=os.environ | {"OMP_WAIT_POLICY": "PASSIVE"}
            )
            if done.returncode:
                sys.exit(done.stdout + done.stderr)


if __name__ == "__main__":
    main()
