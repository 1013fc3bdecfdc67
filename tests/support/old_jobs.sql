-- Read by old_jobs.py, which replaces what is in brackets: [id job n] is the identifier of job n, [series N] the
-- numbers n from 0 to N - 1, [json X] the text X as JSON, [hex] 64 random digits.

INSERT INTO scenes (id, tenant_id, name, state, created_at, committed_at, num_files, size_bytes, report)
SELECT [id scene n], 'default', 'Capture ' || n || ' of a kettle', 'ready',
    :end - :years * (1 - 10.0 * n / :num_old), :end - :years * (1 - 10.0 * n / :num_old), 60, 3e8, [json '{}']
FROM [series :num_old / 10 + 1];

INSERT INTO jobs (id, tenant_id, kind, scene_id, preset, params, gpus, priority, labels, seed, state, run,
    created_at, updated_at, started_at, finished_at, progress, failures, losses, losses_without_checkpoint,
    adjustments, event_seq, report_seq, order_id, shard, bundle_id)
SELECT [id job n],
    CASE WHEN n % 10 < 9 THEN 'default' ELSE 'studio_' || (n / 10 % 9) END,
    kind, [id scene n / 10],
    CASE n % 4 WHEN 0 THEN 'tiny' WHEN 1 THEN 'standard' ELSE 'fast' END,
    [json CASE n % 3 WHEN 0 THEN '{"seed": "1"}' ELSE '{}' END], 0, 0,
    [json '{"project": "p' || (n / 1000 % 100) || '"}'], 0, state, 1,
    at, at + 900, at + 100, at + 900,
    [json '{"stage": "joint", "step": 100, "num_steps": 100, "fraction": 1.0, "eta_s": 0.0, "steps_per_s": 9.0,
        "loss": 0.01, "psnr": 30.0}'], 0, 0, 0, [json '{}'], 4, 9,
    CASE WHEN kind IN ('render', 'batch') THEN kind || '_' || [id order n] END,
    CASE WHEN kind IN ('render', 'batch') THEN 0 END,
    CASE WHEN kind = 'train' AND state = 'succeeded' THEN [id bundle n] END
FROM (
    SELECT n, :end - :years * (1 - 1.0 * n / :num_old) - 1000 AS at,
        CASE WHEN n % 100 < 70 THEN 'train' WHEN n % 100 < 85 THEN 'render' WHEN n % 100 < 92 THEN 'check'
            WHEN n % 100 < 97 THEN 'prepare' WHEN n % 100 < 99 THEN 'bake' ELSE 'batch' END AS kind,
        CASE WHEN n / 7 % 50 < 45 THEN 'succeeded' WHEN n / 7 % 50 < 48 THEN 'failed'
            ELSE 'cancelled' END AS state
    FROM [series :num_old]
) AS made;

INSERT INTO events (job_id, seq, tenant_id, at, type, run, state, progress, message, sha256, name)
SELECT jobs.id, each.n + 1, tenant_id, created_at + 100 * each.n,
    CASE each.n WHEN 2 THEN 'progress' ELSE 'state' END, 1,
    CASE each.n WHEN 0 THEN 'queued' WHEN 1 THEN 'running' WHEN 3 THEN jobs.state ELSE '' END,
    CASE each.n WHEN 2 THEN progress END, '', '', ''
FROM jobs CROSS JOIN (SELECT 0 AS n UNION ALL SELECT 1 UNION ALL SELECT 2 UNION ALL SELECT 3) AS each;

INSERT INTO job_labels (job_id, name, tenant_id, value)
SELECT [id job n], 'project', CASE WHEN n % 10 < 9 THEN 'default' ELSE 'studio_' || (n / 10 % 9) END,
    'p' || (n / 1000 % 100)
FROM [series :num_old];

INSERT INTO render_orders (id, tenant_id, kind, name, spec, num_pictures, num_shards, created_at)
SELECT order_id, tenant_id, kind, kind, [json '{}'], 10, 1, created_at FROM jobs WHERE order_id IS NOT NULL;

INSERT INTO bundles (id, tenant_id, job_id, scene_id, created_at)
SELECT bundle_id, tenant_id, id, scene_id, finished_at FROM jobs WHERE bundle_id IS NOT NULL;

INSERT INTO bundle_files (bundle_id, path, tenant_id, sha256, size_bytes, media_type, gzip_bytes)
SELECT bundle_id, path, tenant_id, [hex], 1e6, 'application/octet-stream', 0
FROM jobs CROSS JOIN (SELECT 'manifest.json' AS path UNION ALL SELECT 'mesh.glb') AS file
WHERE bundle_id IS NOT NULL;

INSERT INTO blobs (sha256, tenant_id, size_bytes, media_type, touched_at)
SELECT sha256, tenant_id, size_bytes, media_type, 0 FROM bundle_files;

INSERT INTO jobs (id, tenant_id, kind, scene_id, preset, params, gpus, priority, labels, seed, state, run,
    created_at, updated_at, failures, losses, losses_without_checkpoint, adjustments, event_seq, report_seq)
SELECT [id job n + 1000000000], CASE WHEN n % 10 = 0 THEN 'default' ELSE 'studio_' || (n % 100) END,
    'train', [id scene 0], 'standard', [json '{}'], 1, n % 3, [json '{}'], 0, 'queued', 0,
    :end + 0.001 * n, :end + 0.001 * n, 0, 0, 0, [json '{}'], 1, 0
FROM [series :num_queued];

INSERT INTO events (job_id, seq, tenant_id, at, type, run, state, message, sha256, name)
SELECT id, 1, tenant_id, created_at, 'state', 0, 'queued', '', '', '' FROM jobs WHERE state = 'queued';
