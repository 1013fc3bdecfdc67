"""Create a bucket if it is missing: `make_bucket.py NAME`, with AWS's variables for where and as whom."""

import sys

import boto3
from botocore.config import Config


def main(name: str) -> None:
    """Create the bucket, unless it is there."""
    client = boto3.client("s3", config=Config(s3={"addressing_style": "path"}))
    if name in {each["Name"] for each in client.list_buckets()["Buckets"]}:
        print(f"bucket {name} is there")
        return
    client.create_bucket(Bucket=name)
    print(f"bucket {name} was created")


if __name__ == "__main__":
    main(sys.argv[1])
