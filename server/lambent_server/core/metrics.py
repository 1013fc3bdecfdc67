"""The counters of one server, for Prometheus."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

OWN = CollectorRegistry()

REQUEST_SECONDS = Histogram(
    "lambent_request_seconds",
    "Time from the header of a request to the end of its response.",
    ["method", "route", "status"],
    buckets=(0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0),
    registry=OWN,
)
OPEN_STREAMS = Gauge("lambent_open_streams", "Open event streams.", registry=OWN)
OPEN_FILES = Gauge("lambent_open_files", "Open files of the server, connections included.", registry=OWN)
CONNECTIONS_CLOSED = Counter(
    "lambent_connections_closed_total", "Connections without a request, closed as too many.", registry=OWN
)
REQUESTS_REFUSED = Counter(
    "lambent_requests_refused_total", "Requests beyond a limit of connections.", ["code"], registry=OWN
)
RUNS_LOST = Counter("lambent_runs_lost_total", "Runs whose process vanished.", registry=OWN)
RUNS_STARTED = Counter("lambent_runs_started_total", "Runs that were started.", registry=OWN)
RUNS_FAILED = Counter("lambent_runs_failed_total", "Runs that failed, by cause.", ["cause"], registry=OWN)
UPLOAD_BYTES = Counter("lambent_upload_bytes_total", "Bytes of files uploaded over REST.", registry=OWN)
DIRECT_BYTES = Counter(
    "lambent_direct_upload_bytes_total", "Bytes of files uploaded directly to the store.", registry=OWN
)
WORKER_CALLS_REFUSED = Counter(
    "lambent_worker_calls_refused_total",
    "Calls of runs beyond their share, by reason.",
    ["reason"],
    registry=OWN,
)
BLOBS_DAMAGED = Counter(
    "lambent_blobs_damaged_total",
    "Files of the store whose bytes did not match their hash.",
    registry=OWN,
)
CHECKED_BYTES = Counter(
    "lambent_checked_bytes_total",
    "Bytes of the store that were compared with their hashes.",
    registry=OWN,
)
WEBHOOK_ATTEMPTS = Counter(
    "lambent_webhook_attempts_total",
    "Attempts to deliver webhooks, by outcome.",
    ["outcome"],
    registry=OWN,
)
