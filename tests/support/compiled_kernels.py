"""Triton kernels compiled without a GPU, and what the compiled code needs."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import torch
import triton
from flashcache.kernels import gpu

TARGETS = (80, 90, 120)
"""Compute capabilities times ten: A100, H100 and H200, RTX 50."""

RESOURCES = re.compile(r"REG:(\d+) STACK:(\d+) SHARED:\d+ LOCAL:(\d+)")


def compiled(kernel: Any, constants: dict[str, Any], target: int, **types: str) -> Any:
    """Return a kernel as Triton compiles it for tensors of torch's, whose addresses are multiples of 16.

    Arguments are pointers to float32 unless `constants` or `types` name them.
    """
    types = types | dict.fromkeys(constants, "constexpr")
    signature = {argument: types.get(argument, "*fp32") for argument in kernel.arg_names}
    aligned = {
        (place,): [["tt.divisibility", 16]]
        for place, kind in enumerate(signature.values())
        if kind.startswith("*")
    }
    source = triton.compiler.ASTSource(fn=kernel, signature=signature, constexprs=constants, attrs=aligned)
    gpu_target = triton.backends.compiler.GPUTarget("cuda", target, 32)
    return triton.compile(source, target=gpu_target, options=gpu.OPTIONS)


def resources(kernel: Any) -> tuple[int, int]:
    """Return registers, and bytes of stack and local memory, per thread."""
    tool = Path(triton.__file__).parent / "backends/nvidia/bin/cuobjdump"
    with tempfile.NamedTemporaryFile(suffix=".cubin") as file:
        file.write(kernel.asm["cubin"])
        file.flush()
        command = [tool, "--dump-resource-usage", file.name]
        listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    [found] = RESOURCES.findall(listing)
    registers, stack, local = map(int, found)
    return registers, stack + local


def interpreted(folder: Path, script: str, *words: str) -> Any:
    """Return what a script of this folder stores: kernels as Triton's interpreter runs them."""
    path = folder / "answers.pt"
    command = [sys.executable, str(Path(__file__).with_name(script)), str(path), *words]
    environment = os.environ | {"TRITON_INTERPRET": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return torch.load(path)
