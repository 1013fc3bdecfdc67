"""An OpenID Connect provider as a process: discovery, codes with PKCE, ID tokens with real signatures.

`python oidc_provider.py` prints its address. Whoever asks is signed in as the person that was last
sent to `/control`; what else is sent there makes it misbehave.
"""

import base64
import contextlib
import json
import secrets
import subprocess
import sys
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

import httpx2
from authlib.oauth2.rfc7636 import create_s256_code_challenge
from joserfc import jwt
from joserfc.jwk import ECKey, KeySet, OctKey, RSAKey

CLIENT_ID = "lambent"
CLIENT_SECRET = "a secret with : and %"


class Provider:
    """Keys, codes, and what `/control` has asked for."""

    def __init__(self, issuer: str) -> None:
        self.issuer = issuer
        self.keys = [RSAKey.generate_key(2048, {"kid": "first", "use": "sig"})]
        self.codes: dict[str, dict[str, str]] = {}
        self.person: dict[str, Any] = {"sub": "nobody"}
        self.faults: dict[str, Any] = {}
        self.used: list[str] = []

    def control(self, order: dict[str, Any]) -> None:
        """Change the person, the faults of tokens from now on, or the keys."""
        self.person = order.get("person", self.person)
        self.faults = order.get("faults", {})
        if "rotate" in order:
            make = ECKey.generate_key if order["rotate"] == "EC" else RSAKey.generate_key
            size = "P-256" if order["rotate"] == "EC" else 2048
            self.keys = [make(size, {"kid": secrets.token_hex(4), "use": "sig"})]

    def id_token(self, grant: dict[str, str]) -> str:
        """Return a token for what a code stands for, with the faults that are asked for."""
        at = int(time.time())
        claims = {"iss": self.issuer, "aud": CLIENT_ID, "iat": at, "exp": at + 300, "nonce": grant["nonce"]}
        claims |= self.person
        claims |= self.faults.get("claims", {})
        claims = {name: value for name, value in claims.items() if value is not None}
        key: Any = self.keys[-1]
        algorithm = "ES256" if isinstance(key, ECKey) else "RS256"
        if self.faults.get("key") == "foreign":
            key = RSAKey.generate_key(2048, {"kid": key.kid})
        if self.faults.get("key") == "none":
            head, body = ({"alg": "none"}, claims)
            parts = (
                base64.urlsafe_b64encode(json.dumps(p).encode()).decode().rstrip("=") for p in (head, body)
            )
            return ".".join(parts) + "."
        if self.faults.get("key") == "secret":
            key, algorithm = OctKey.import_key(CLIENT_SECRET), "HS256"
            return jwt.encode({"alg": algorithm}, claims, key, algorithms=[algorithm])
        return jwt.encode({"alg": algorithm, "kid": key.kid}, claims, key, algorithms=[algorithm])


class Handler(BaseHTTPRequestHandler):
    """The endpoints."""

    provider: Provider

    def log_message(self, *_: object) -> None:
        """Be quiet."""

    def _send(self, status: int, document: Any, **headers: str) -> None:
        body = json.dumps(document).encode()
        self.send_response(status)
        for name, value in {
            "Content-Type": "application/json",
            "Content-Length": str(len(body)),
            **headers,
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def do_GET(self) -> None:
        """Answer discovery, keys and sign-ins."""
        url, provider = urlsplit(self.path), self.provider
        provider.used.append(url.path)
        if url.path == "/.well-known/openid-configuration":
            names = {"authorization_endpoint": "authorize", "token_endpoint": "token", "jwks_uri": "jwks"}
            places = {name: f"{provider.issuer}/{path}" for name, path in names.items()}
            promised = {"authorization_response_iss_parameter_supported": True}
            self._send(200, {"issuer": provider.issuer, **places, **promised})
        elif url.path == "/jwks":
            self._send(200, KeySet(provider.keys).as_dict(private=False))
        elif url.path == "/used":
            self._send(200, provider.used)
        elif url.path == "/authorize":
            given = {name: values[0] for name, values in parse_qs(url.query).items()}
            assert given["response_type"] == "code"
            assert given["client_id"] == CLIENT_ID
            assert given["code_challenge_method"] == "S256"
            assert "openid" in given["scope"].split()
            code = secrets.token_urlsafe(16)
            provider.codes[code] = given
            back = urlencode({"code": code, "state": given["state"], "iss": provider.issuer})
            self._send(302, {}, Location=f"{given['redirect_uri']}?{back}")
        else:
            self._send(404, {})

    def do_POST(self) -> None:
        """Answer requests for tokens, and orders."""
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path == "/control":
            self.provider.control(json.loads(body))
            self._send(200, {})
            return
        form = {name: values[0] for name, values in parse_qs(body.decode()).items()}
        basic = base64.b64encode(f"{CLIENT_ID}:{CLIENT_SECRET}".encode()).decode()
        grant = self.provider.codes.pop(form.get("code", ""), None)
        if self.headers["Authorization"] != f"Basic {basic}":
            self._send(401, {"error": "invalid_client"})
        elif (
            grant is None
            or form["redirect_uri"] != grant["redirect_uri"]
            or create_s256_code_challenge(form["code_verifier"]) != grant["code_challenge"]
        ):
            self._send(400, {"error": "invalid_grant"})
        else:
            tokens = {"access_token": secrets.token_urlsafe(), "token_type": "Bearer"}
            self._send(200, {**tokens, "id_token": self.provider.id_token(grant)})


class Running:
    """The process, from outside."""

    def __init__(self, issuer: str) -> None:
        self.issuer = issuer
        self._client = httpx2.Client(base_url=issuer, verify=False)

    def control(self, **order: Any) -> None:
        """Change person, faults or keys."""
        assert self._client.post("/control", json=order).status_code == 200

    def used(self) -> list[str]:
        """Return the paths that were asked for."""
        return self._client.get("/used").json()

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


@contextlib.contextmanager
def running() -> Iterator[Running]:
    """Yield a provider that runs."""
    process = subprocess.Popen([sys.executable, __file__], stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        provider = Running(process.stdout.readline().decode().strip())
        yield provider
        provider.close()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


if __name__ == "__main__":
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    Handler.provider = Provider(f"http://127.0.0.1:{server.server_port}")
    print(Handler.provider.issuer, flush=True)
    server.serve_forever()
