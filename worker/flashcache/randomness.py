"""Where random numbers come from: counted streams, never global state."""

from hashlib import sha256

import torch


def generator_for(seed: int, stage: str, step: int, purpose: str, device: torch.device) -> torch.Generator:
    """Return a fresh random generator that depends on nothing but the arguments.

    Streams of different purposes are independent, and a resumed run continues as if never stopped.
    """
    digest = sha256(f"{seed}/{stage}/{step}/{purpose}".encode()).digest()
    generator = torch.Generator(device=device)
    generator.manual_seed(int.from_bytes(digest[:8], "little") >> 1)
    return generator
