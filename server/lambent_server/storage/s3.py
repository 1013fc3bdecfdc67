"""A bucket of S3, or of a server that speaks its protocol: what obstore does not do.

Presigned addresses whose length and checksum are part of the signature, uploads in parts, copies of exactly
one version, and a check of all of it when a server starts. Keys are relative to the prefix of the URL.
"""

import base64
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any
from urllib.parse import urlsplit

from lambent_core.errors import pip_install

MAX_COPY_BYTES = 5 * 1024**3
"""Largest object that S3 copies in one request."""
# The bucket was there when the server started; a store that is coming back may not know it for a moment.
_UNAVAILABLE = frozenset(
    {"SlowDown", "ServiceUnavailable", "InternalError", "RequestTimeout", "NoSuchBucket", "503", "500"}
)
_MISSING = frozenset({"NoSuchKey", "NoSuchUpload", "404", "NotFound"})
_SKEWED = frozenset({"RequestTimeTooSkewed", "RequestExpired"})
_CREDENTIALS = frozenset({"InvalidAccessKeyId", "SignatureDoesNotMatch", "InvalidToken", "ExpiredToken"})
_BAD_DIGEST = frozenset(
    {"BadDigest", "InvalidDigest", "XAmzContentChecksumMismatch", "InvalidRequest", "400"}
)


class StoreUnavailableError(OSError):
    """The store does not answer, or asks to come back later."""


class StoreSetupError(ValueError):
    """The store cannot be used as it is set up; the message says why and what to do."""


@dataclass(frozen=True, kw_only=True, slots=True)
class S3Options:
    """Where a bucket is. Credentials come from the variables and files that every AWS program reads."""

    url: str
    """"s3://bucket" or "s3://bucket/prefix"."""
    endpoint: str | None = None
    """Address of the server; None for that of AWS, or of AWS_ENDPOINT_URL."""
    public_endpoint: str | None = None
    """Its address for clients and run processes, if it differs."""
    region: str | None = None


@dataclass(frozen=True, slots=True)
class Version:
    """What a store has under a name at one moment: every change gives another one."""

    size_bytes: int
    etag: str

    @classmethod
    def of(cls, meta: Any) -> "Version":
        """Return the version that obstore's description of an object names."""
        return cls(int(meta["size"]), str(meta["e_tag"] or meta["last_modified"].isoformat()))


class S3Bucket:
    """Requests to one bucket, below one prefix. Safe to use from several threads."""

    def __init__(self, options: S3Options) -> None:
        try:
            import boto3
            from botocore.config import Config
        except ModuleNotFoundError as error:
            raise StoreSetupError(f"a store in S3 needs boto3: {pip_install('s3')}") from error
        parts = urlsplit(options.url)
        self.name, self._prefix = parts.netloc, parts.path.strip("/")
        if not self.name:
            raise StoreSetupError(f"{options.url} names no bucket; give a URL such as s3://bucket/prefix")
        self.session: Any = boto3.Session(region_name=options.region)
        if self.session.get_credentials() is None:
            raise StoreSetupError(
                "there are no credentials for S3; set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or "
                "AWS_PROFILE, or give the machine a role"
            )
        self.region = self.session.region_name or "us-east-1"
        config = Config(
            signature_version="s3v4",
            s3={"addressing_style": "auto" if options.endpoint is None else "path"},
            connect_timeout=5,
            read_timeout=60,
            retries={"total_max_attempts": 2, "mode": "standard"},
            max_pool_connections=32,
            # Other servers do not know the checksums that the library would add.
            request_checksum_calculation="when_required",
            response_checksum_validation="when_required",
        )

        def client(endpoint: str | None) -> Any:
            return self.session.client("s3", endpoint_url=endpoint, region_name=self.region, config=config)

        self._client = client(options.endpoint)
        self.endpoint: str = self._client.meta.endpoint_url
        self._signer = client(options.public_endpoint) if options.public_endpoint else self._client
        self.verifies = False
        """Whether the server refuses bytes that do not match the checksum they are announced with."""
        address = urlsplit(self.sign_get("x", "text/plain", 1))
        self.origin = f"{address.scheme}://{address.netloc}"
        """Origin of presigned addresses, for the policy of the pages."""

    def obstore(self, *, timeout_s: float, num_retries: int) -> Any:
        """Return the bucket as a store of obstore's, with the same credentials."""
        from obstore.auth.boto3 import Boto3CredentialProvider
        from obstore.store import S3Store

        return S3Store(
            self.name,
            prefix=self._prefix or None,
            endpoint=self.endpoint,
            region=self.region,
            virtual_hosted_style_request=False,
            client_options={
                "allow_http": True,
                "connect_timeout": timedelta(seconds=min(timeout_s, 5)),
                "timeout": timedelta(seconds=timeout_s),
            },
            retry_config={"max_retries": num_retries, "retry_timeout": timedelta(seconds=timeout_s)},
            credential_provider=Boto3CredentialProvider(self.session, ttl=timedelta(minutes=5)),
        )

    def _key(self, key: str) -> str:
        return f"{self._prefix}/{key}" if self._prefix else key

    def _sign(self, operation: str, seconds: float, key: str, **params: Any) -> str:
        given = {"Bucket": self.name, "Key": self._key(key), **params}
        return str(self._signer.generate_presigned_url(operation, Params=given, ExpiresIn=int(seconds)))

    def sign_get(self, key: str, media_type: str, seconds: float) -> str:
        """Return an address at which an object can be read without credentials for some seconds."""
        more = {
            "ResponseContentType": media_type,
            "ResponseCacheControl": "private, max-age=31536000, immutable",
        }
        return self._sign("get_object", seconds, key, **more)

    def sign_put(self, key: str, sha256: str, size_bytes: int, seconds: float) -> tuple[str, dict[str, str]]:
        """Return an address to which exactly these bytes can be sent, and the headers to send with them."""
        if not self.verifies:
            return self._sign("put_object", seconds, key, ContentLength=size_bytes), {}
        checksum = base64.b64encode(bytes.fromhex(sha256)).decode()
        url = self._sign("put_object", seconds, key, ContentLength=size_bytes, ChecksumSHA256=checksum)
        return url, {"x-amz-checksum-sha256": checksum}

    def sign_part(self, key: str, upload_id: str, number: int, size_bytes: int, seconds: float) -> str:
        """Return an address to which one part of an upload can be sent."""
        more = {"UploadId": upload_id, "PartNumber": number, "ContentLength": size_bytes}
        return self._sign("upload_part", seconds, key, **more)

    def head(self, key: str) -> Version | None:
        """Return the current version of an object, or None if there is none."""
        try:
            with errors():
                answer = self._client.head_object(Bucket=self.name, Key=self._key(key))
        except FileNotFoundError:
            return None
        return Version(int(answer["ContentLength"]), answer["ETag"])

    def read(self, key: str, version: Version) -> Iterator[bytes]:
        """Return the bytes of exactly this version, in pieces."""
        with errors():
            answer = self._client.get_object(Bucket=self.name, Key=self._key(key), IfMatch=version.etag)
            yield from answer["Body"].iter_chunks(1024 * 1024)

    def copy(self, key: str, version: Version, target: str) -> None:
        """Copy exactly this version; FileNotFoundError if it no longer exists."""
        source = {"Bucket": self.name, "Key": self._key(key)}
        with errors():
            self._client.copy_object(
                Bucket=self.name, Key=self._key(target), CopySource=source, CopySourceIfMatch=version.etag
            )

    def delete(self, key: str) -> None:
        """Delete an object, if it exists."""
        with errors():
            self._client.delete_object(Bucket=self.name, Key=self._key(key))

    def listed(self, prefix: str) -> Iterator[tuple[str, int, float]]:
        """Yield key, size and modification time (Unix seconds) of the objects below a prefix."""
        with errors():
            pages = self._client.get_paginator("list_objects_v2")
            for page in pages.paginate(Bucket=self.name, Prefix=self._key(prefix)):
                for each in page.get("Contents", ()):
                    yield self._relative(each["Key"]), int(each["Size"]), each["LastModified"].timestamp()

    def _relative(self, key: str) -> str:
        return key[len(self._prefix) + 1 :] if self._prefix else key

    def uploads(self, prefix: str) -> Iterator[tuple[str, str, float]]:
        """Yield key, id and start (Unix seconds) of the uploads in parts that have not been completed."""
        with errors():
            pages = self._client.get_paginator("list_multipart_uploads")
            for page in pages.paginate(Bucket=self.name, Prefix=self._key(prefix)):
                for each in page.get("Uploads", ()):
                    yield self._relative(each["Key"]), each["UploadId"], each["Initiated"].timestamp()

    def begin(self, key: str) -> str:
        """Begin an upload in parts and return its id."""
        with errors():
            return str(self._client.create_multipart_upload(Bucket=self.name, Key=self._key(key))["UploadId"])

    def parts(self, key: str, upload_id: str) -> dict[int, Version]:
        """Return the parts of an upload that have been sent, by their numbers."""
        with errors():
            pages = self._client.get_paginator("list_parts")
            return {
                int(part["PartNumber"]): Version(int(part["Size"]), part["ETag"])
                for page in pages.paginate(Bucket=self.name, Key=self._key(key), UploadId=upload_id)
                for part in page.get("Parts", ())
            }

    def complete(self, key: str, upload_id: str, parts: Mapping[int, Version]) -> None:
        """Make an object of the parts of an upload."""
        listed = [{"PartNumber": number, "ETag": parts[number].etag} for number in sorted(parts)]
        with errors():
            self._client.complete_multipart_upload(
                Bucket=self.name,
                Key=self._key(key),
                UploadId=upload_id,
                MultipartUpload={"Parts": listed},
            )

    def abort(self, key: str, upload_id: str) -> None:
        """Give up an upload in parts, if it is still open, and delete its parts."""
        try:
            with errors():
                self._client.abort_multipart_upload(Bucket=self.name, Key=self._key(key), UploadId=upload_id)
        except FileNotFoundError:
            pass

    def check(self) -> None:
        """Try everything that the server needs; StoreSetupError says what does not work.

        Finds out whether the server verifies checksums (`verifies`).
        """
        key = f"uploads/check-{secrets.token_hex(8)}"
        doing = "list the bucket"
        try:
            self._client.list_objects_v2(Bucket=self.name, Prefix=self._key("uploads/"), MaxKeys=1)
            doing = "write an object (s3:PutObject)"
            self.verifies = self._refuses_other_bytes(key)
            self._client.put_object(Bucket=self.name, Key=self._key(key), Body=b"check")
            doing = "read an object (s3:GetObject)"
            version = self.head(key)
            if version is None or b"".join(self.read(key, version)) != b"check":
                raise StoreSetupError(f"the bucket {self.name} does not return what was written to it")
            doing = "copy an object (s3:GetObject, s3:PutObject)"
            self.copy(key, version, f"{key}-copy")
            doing = "upload in parts (s3:PutObject, s3:ListBucketMultipartUploads, s3:AbortMultipartUpload)"
            upload_id = self.begin(key)
            list(self.uploads(key))
            self.abort(key, upload_id)
            doing = "delete an object (s3:DeleteObject)"
            self.delete(f"{key}-copy")
            self.delete(key)
        except StoreSetupError:
            raise
        except Exception as error:
            raise self._setup_error(error, doing) from error

    def _refuses_other_bytes(self, key: str) -> bool:
        from botocore.exceptions import ClientError

        checksum = base64.b64encode(bytes(32)).decode()
        try:
            self._client.put_object(
                Bucket=self.name, Key=self._key(key), Body=b"check", ChecksumSHA256=checksum
            )
        except ClientError as error:
            code = error.response["Error"]["Code"]
            if code not in _BAD_DIGEST and code != "NotImplemented":
                raise
            return code in _BAD_DIGEST
        return False

    def _setup_error(self, error: Exception, doing: str) -> StoreSetupError:
        from botocore.exceptions import ClientError

        cause = error if isinstance(error, ClientError) else error.__cause__
        if not isinstance(cause, ClientError):
            return StoreSetupError(
                f"{self.endpoint} does not answer ({type(cause or error).__name__}); check that the server "
                "runs and that LAMBENT_STORE_ENDPOINT is right"
            )
        code = cause.response["Error"]["Code"]
        message = cause.response["Error"].get("Message", "")
        if code == "NoSuchBucket":
            return StoreSetupError(
                f"there is no bucket {self.name!r} at {self.endpoint}; create it, or correct LAMBENT_STORE"
            )
        if code in _SKEWED:
            return StoreSetupError(
                f"the clocks of this machine and of {self.endpoint} differ too much ({code}); "
                "synchronise them"
            )
        if code in _CREDENTIALS:
            return StoreSetupError(
                f"{self.endpoint} refuses the credentials ({code}: {message}); check AWS_*"
            )
        return StoreSetupError(
            f"this server's credentials may not {doing} in the bucket {self.name!r} ({code}: {message}); "
            "docs/howto/object-store.md has the policy that they need"
        )


@contextmanager
def errors() -> Iterator[None]:
    """Convert the library's exceptions into OSError, which the rest of the server handles."""
    from botocore.exceptions import BotoCoreError, ClientError

    try:
        yield
    except ClientError as error:
        code = str(error.response["Error"]["Code"])
        if code in _MISSING or code in ("PreconditionFailed", "412"):
            raise FileNotFoundError(code) from error
        status = error.response["ResponseMetadata"].get("HTTPStatusCode", 0)
        if code in _UNAVAILABLE or status >= 500:
            raise StoreUnavailableError(code) from error
        raise OSError(str(error)) from error
    except BotoCoreError as error:
        raise StoreUnavailableError(str(error)) from error
