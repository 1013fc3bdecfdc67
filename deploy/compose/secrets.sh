#!/bin/sh
# Make the secrets of docker-compose.yml in secrets/ beside it. What is there already stays as it is.
set -eu
cd "$(dirname "$0")/../.."
umask 077
mkdir -p "${SECRETS:=secrets}"
cd "$SECRETS"

random() { od -An -N24 -tx1 /dev/urandom | tr -d ' \n'; }

# Usage: secret NAME <content. Its folder keeps others of this machine out; containers run as other users.
secret() {
    if [ -e "$1" ]; then cat >/dev/null; else cat >"$1.new" && chmod 0444 "$1.new" && mv "$1.new" "$1"; fi
}

random | secret postgres_password
random | secret ray_token
# The first key of a server can do everything; replace this one by one that can only read: see docker.md.
printf 'none yet' | secret metrics_key
if [ ! -e s3_credentials ] || [ ! -e s3_identities.json ]; then
    key=$(random) word=$(random)
    rm -f s3_credentials s3_identities.json
    printf '[default]\naws_access_key_id = %s\naws_secret_access_key = %s\n' "$key" "$word" | secret s3_credentials
    printf '{"identities": [{"name": "lambent", "credentials": [{"accessKey": "%s", "secretKey": "%s"}], "actions": ["Admin", "Read", "Write", "List", "Tagging"]}]}\n' \
        "$key" "$word" | secret s3_identities.json
fi
