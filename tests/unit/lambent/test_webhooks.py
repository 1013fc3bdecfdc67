"""Receivers accept what the server signed, and nothing else."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lambent.webhooks import WebhookVerificationError, verify

# The example that the libraries of the Standard Webhooks specification test themselves with.
SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
OTHER = "whsec_C2FVsBQIhrscChlQIMV+b5sSYspob7oD"
BODY = b'{"test": 2432232314}'
AT = 1614265330.0
HEADERS = {
    "Webhook-Id": "msg_p5jXN8AQM9LWM0D4loKWxJek",
    "Webhook-Timestamp": "1614265330",
    "Webhook-Signature": "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=",
}


def code(headers: dict[str, str], body: bytes = BODY, secret: str = SECRET, now_s: float = AT) -> str:
    """Return why a delivery is refused."""
    with pytest.raises(WebhookVerificationError) as caught:
        verify(secret, headers, body, now_s=now_s)
    return caught.value.code


def test_the_example_of_the_specification_is_accepted():
    assert verify(SECRET, HEADERS, BODY, now_s=AT + 299) == json.loads(BODY)
    assert verify([OTHER, SECRET], HEADERS, BODY, now_s=AT - 299) == json.loads(BODY)
    several = {**HEADERS, "Webhook-Signature": f"v1a,zzz v1,!! v1,AAAA {HEADERS['Webhook-Signature']}"}
    assert verify(SECRET, several, BODY, now_s=AT) == json.loads(BODY)


def test_old_and_early_deliveries_are_refused():
    assert code(HEADERS, now_s=AT + 301) == "webhook.timestamp"
    assert code(HEADERS, now_s=AT - 301) == "webhook.timestamp"
    assert verify(SECRET, HEADERS, BODY, now_s=AT + 400, tolerance_s=500)


@pytest.mark.parametrize("name", sorted(HEADERS))
def test_a_missing_header_is_named(name: str):
    with pytest.raises(WebhookVerificationError, match=name.lower()):
        verify(SECRET, {key: value for key, value in HEADERS.items() if key != name}, BODY)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"Webhook-Id": "msg_other"}, "webhook.signature"),
        ({"Webhook-Timestamp": "1614265331"}, "webhook.signature"),
        ({"Webhook-Timestamp": "soon"}, "webhook.timestamp"),
        ({"Webhook-Timestamp": "-1614265330"}, "webhook.timestamp"),
        ({"Webhook-Timestamp": "9" * 400}, "webhook.timestamp"),
        ({"Webhook-Signature": ""}, "webhook.signature"),
        ({"Webhook-Signature": HEADERS["Webhook-Signature"].replace("v1,", "v2,")}, "webhook.signature"),
    ],
)
def test_a_changed_header_is_noticed(changed: dict[str, str], expected: str):
    assert code({**HEADERS, **changed}) == expected


def test_another_secret_signs_otherwise():
    assert code(HEADERS, secret=OTHER) == "webhook.signature"


def test_a_secret_that_is_none_is_a_mistake_of_the_receiver():
    with pytest.raises(ValueError, match="whsec_"):
        verify("whsec_?", HEADERS, BODY, now_s=AT)


@given(st.binary(max_size=60))
def test_no_other_body_is_accepted(body: bytes):
    if body != BODY:
        assert code(HEADERS, body) == "webhook.signature"
