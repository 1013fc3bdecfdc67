"""Requests that follow one another, with what earlier answers gave, are all answered as described."""

import os

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, settings
from schemathesis.specs.openapi.checks import positive_data_acceptance
from support.api import KEY, opened

EXAMPLES = int(os.environ.get("LAMBENT_FUZZ_SEQUENCES", "4"))
"""Sequences; `make hostile` has more."""
STEPS = 12

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def test_sequences_of_requests_are_answered_as_described(tmp_path):
    made: set[str] = set()
    with opened(tmp_path / "data", max_wait_s=0.01, allowed_hosts=("testserver",)) as api:
        schema = schemathesis.openapi.from_asgi("/openapi.json", api.client.app, timeout=120)
        # A stream does not end; tests/chaos follows it.
        schema = schema.exclude(path="/v1/events")

        class Steps(schema.as_state_machine()):  # type: ignore[misc]
            def get_call_kwargs(self, case):
                return {"headers": {"Authorization": f"Bearer {KEY}"}}

            def validate_response(self, response, case, **options):
                made.add(f"{case.operation.method} {case.operation.path}")
                case.validate_response(response, excluded_checks=[positive_data_acceptance])
                assert response.status_code < 500

        Steps.run(
            settings=settings(
                max_examples=EXAMPLES,
                stateful_step_count=STEPS,
                deadline=None,
                derandomize=True,
                suppress_health_check=list(HealthCheck),
                phases=[Phase.explicit, Phase.generate],
            )
        )
        # It got beyond making things: some request had the id of one.
        assert any("{" in each for each in made), made
