"""The benchmark `service_load` on a small scale: streams and slow senders, and the service beside them."""

import sys
from pathlib import Path

import numpy as np
import pytest
from support.live_server import LiveServer

sys.path.append(str(Path(__file__).parents[2]))

from benchmarks.service_load import NUM_CLIENTS, load

pytestmark = pytest.mark.slow
STREAMS, SENDERS = 152, 40


def test_streams_and_slow_senders_are_served_and_nobody_else_notices(tmp_path: Path):
    with LiveServer(tmp_path / "data", local_slots=1, stream_poll_s=1.0, progress_interval_s=0.5) as server:
        result = load(server, streams=STREAMS, senders=SENDERS, seconds=3.0, rate=10.0)
        assert server.end() < 10.0
    assert result["open"] == STREAMS
    assert (result["complete"], result["wrong"]) == (STREAMS, 0)
    assert result["submitted"] == 3
    # Nobody was refused, and no sender has been cut off yet.
    assert result["counts"] == {"stream 200": STREAMS}
    assert result["server"]["files"] > STREAMS + SENDERS
    # A thread for each would be 192; these are the 40 of requests and those of the background.
    assert result["server"]["threads"] <= 50
    idle, busy = result["idle"], result["busy"]
    # Medians, with room for what else the machine does: the benchmark measures, this finds what is broken.
    assert np.median(busy.health) < max(0.25, 4.0 * np.median(idle.health))
    assert np.median(busy.submit) < max(0.5, 6.0 * np.median(idle.submit))
    assert STREAMS % NUM_CLIENTS == 0
