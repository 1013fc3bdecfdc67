"""Signatures agree with the Standard Webhooks specification."""

import base64

from lambent_server.webhooks.signing import new_signing_secret, signature, signed_headers

# The example that the libraries of the specification test themselves with.
SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
IDENTIFIER, TIMESTAMP, BODY = "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}'
SIGNATURE = "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_the_signature_is_that_of_the_specification():
    assert signature(SECRET, IDENTIFIER, TIMESTAMP, BODY) == SIGNATURE


def test_every_active_secret_signs():
    other = new_signing_secret()
    headers = signed_headers([other, SECRET], IDENTIFIER, TIMESTAMP, BODY)
    assert headers == {
        "webhook-id": IDENTIFIER,
        "webhook-timestamp": str(TIMESTAMP),
        "webhook-signature": f"{signature(other, IDENTIFIER, TIMESTAMP, BODY)} {SIGNATURE}",
    }


def test_secrets_are_256_random_bits():
    made = {new_signing_secret() for _ in range(10)}
    assert len(made) == 10
    assert all(len(base64.b64decode(secret.removeprefix("whsec_"))) == 32 for secret in made)
