{{- define "lambent.name" -}}
{{ .Release.Name | trunc 40 | trimSuffix "-" }}
{{- end }}

{{- define "lambent.image" -}}
{{ .Values.image.repository }}:{{ default .Chart.AppVersion .Values.image.tag }}
{{- end }}

{{- define "lambent.selector" -}}
app.kubernetes.io/name: lambent
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "lambent.labels" -}}
{{ include "lambent.selector" . }}
app.kubernetes.io/version: {{ default .Chart.AppVersion .Values.image.tag | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ .Chart.Name }}-{{ .Chart.Version }}
{{- end }}

{{- define "lambent.podSecurity" -}}
runAsNonRoot: true
runAsUser: 10001
runAsGroup: 10001
fsGroup: 10001
fsGroupChangePolicy: OnRootMismatch
seccompProfile: {type: RuntimeDefault}
{{- end }}

{{- define "lambent.containerSecurity" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: {drop: [ALL]}
{{- end }}

{{- /* What the values must say, in words: the schema cannot know that one of two is needed. */ -}}
{{- define "lambent.require" -}}
{{- if not (or .Values.store.url .Values.store.existingClaim) }}
{{- fail "say where files go: store.url (s3://bucket/prefix) or store.existingClaim (a volume that many pods can write)" }}
{{- end }}
{{- if and .Values.store.url .Values.store.existingClaim }}
{{- fail "store.url and store.existingClaim exclude each other" }}
{{- end }}
{{- if and .Values.ingress.enabled (not .Values.ingress.host) }}
{{- fail "ingress.enabled needs ingress.host" }}
{{- end }}
{{- if and .Values.ray.address (not .Values.ray.authSecret) }}
{{- fail "ray.address needs ray.authSecret: without a token, whoever reaches Ray can run programs on it" }}
{{- end }}
{{- if and .Values.oidc.issuer (not .Values.oidc.clientId) }}
{{- fail "oidc.issuer needs oidc.clientId" }}
{{- end }}
{{- end }}

{{- /* Environment of servers and workers; a dict of `root`, `slots`, `gpus` and `link` (whether runs reach it). */ -}}
{{- define "lambent.environment" -}}
{{- $values := .root.Values -}}
- name: POD_IP
  valueFrom: {fieldRef: {fieldPath: status.podIP}}
- name: LAMBENT_DATA
  value: /data
- name: LAMBENT_DATABASE
  value: {{ printf "postgresql://%s@%s:%d/%s?sslmode=%s" $values.database.user $values.database.host (int $values.database.port) $values.database.name $values.database.sslMode | quote }}
- name: LAMBENT_DATABASE_PASSWORD_FILE
  value: /run/secrets/database/password
{{- if $values.database.direct.host }}
- name: LAMBENT_DATABASE_DIRECT
  value: {{ printf "postgresql://%s@%s:%d/%s?sslmode=%s" $values.database.user $values.database.direct.host (int $values.database.direct.port) $values.database.name $values.database.sslMode | quote }}
{{- end }}
- name: LAMBENT_STORE
  value: {{ default "file:///store" $values.store.url | quote }}
{{- with $values.store.endpoint }}
- name: LAMBENT_STORE_ENDPOINT
  value: {{ . | quote }}
{{- end }}
{{- with $values.store.publicEndpoint }}
- name: LAMBENT_STORE_PUBLIC_ENDPOINT
  value: {{ . | quote }}
{{- end }}
{{- with $values.store.region }}
- name: LAMBENT_STORE_REGION
  value: {{ . | quote }}
{{- end }}
{{- if $values.store.existingSecret }}
- name: AWS_ACCESS_KEY_ID
  valueFrom: {secretKeyRef: {name: {{ $values.store.existingSecret }}, key: accessKeyId}}
- name: AWS_SECRET_ACCESS_KEY
  valueFrom: {secretKeyRef: {name: {{ $values.store.existingSecret }}, key: secretAccessKey}}
{{- end }}
# Prometheus asks a pod by its address.
- name: LAMBENT_ALLOWED_HOSTS
  value: {{ join "," (concat (list "$(POD_IP)" (include "lambent.name" .root)) (compact (list $values.ingress.host)) $values.server.allowedHosts) | quote }}
{{- with $values.server.trustedProxies }}
- name: LAMBENT_TRUSTED_PROXIES
  value: {{ join "," . | quote }}
{{- end }}
- name: LAMBENT_LOCAL_SLOTS
  value: {{ .slots | quote }}
- name: LAMBENT_LOCAL_GPUS
  value: {{ .gpus | quote }}
{{- if .link }}
- name: LAMBENT_WORKER_ADDRESS
  value: {{ printf "0.0.0.0:%d" (int $values.workerLink.port) | quote }}
- name: LAMBENT_WORKER_PUBLIC_ADDRESS
{{- if $values.workerLink.tlsSecret }}
  value: {{ printf "%s-link.%s.svc:%d" (include "lambent.name" .root) .root.Release.Namespace (int $values.workerLink.port) | quote }}
- name: LAMBENT_WORKER_CERTIFICATE
  value: /run/secrets/worker-link/tls.crt
- name: LAMBENT_WORKER_KEY
  value: /run/secrets/worker-link/tls.key
- name: LAMBENT_WORKER_AUTHORITY
  value: /run/secrets/worker-link/ca.crt
{{- else }}
  value: {{ printf "$(POD_IP):%d" (int $values.workerLink.port) | quote }}
{{- end }}
{{- end }}
{{- if and $values.oidc.issuer .link }}
- name: LAMBENT_OIDC_ISSUER
  value: {{ $values.oidc.issuer | quote }}
- name: LAMBENT_OIDC_CLIENT_ID
  value: {{ $values.oidc.clientId | quote }}
{{- if $values.oidc.existingSecret }}
- name: LAMBENT_OIDC_CLIENT_SECRET_FILE
  value: /run/secrets/oidc/client-secret
{{- end }}
{{- end }}
{{- if and $values.ray.address .link }}
- name: LAMBENT_EXECUTOR
  value: ray
- name: LAMBENT_RAY_ADDRESS
  value: {{ $values.ray.address | quote }}
- name: LAMBENT_RAY_TOKEN_FILE
  value: /run/secrets/ray/token
- name: LAMBENT_RAY_RUN_CPUS
  value: {{ $values.ray.runCpus | quote }}
{{- end }}
{{- range $name, $value := $values.server.environment }}
- name: {{ $name }}
  value: {{ $value | quote }}
{{- end }}
{{- end }}

{{- /* Mounts; a dict of `root` and `link`: whether pods answer runs of others and people, and need the secrets for it. */ -}}
{{- define "lambent.mounts" -}}
{{- $values := .root.Values -}}
- {name: data, mountPath: /data}
- {name: tmp, mountPath: /tmp}
- {name: database, mountPath: /run/secrets/database, readOnly: true}
{{- if $values.store.existingClaim }}
- {name: store, mountPath: /store}
{{- end }}
{{- if and .link $values.workerLink.tlsSecret }}
- {name: worker-link, mountPath: /run/secrets/worker-link, readOnly: true}
{{- end }}
{{- if and .link $values.oidc.issuer $values.oidc.existingSecret }}
- {name: oidc, mountPath: /run/secrets/oidc, readOnly: true}
{{- end }}
{{- if and .link $values.ray.address }}
- {name: ray, mountPath: /run/secrets/ray, readOnly: true}
{{- end }}
{{- end }}

{{- /* Volumes; a dict of `root`, `size` and `link`, as for mounts. */ -}}
{{- define "lambent.volumes" -}}
{{- $values := .root.Values -}}
- name: data
  emptyDir: {sizeLimit: {{ .size }}}
- name: tmp
  emptyDir: {}
- name: database
  secret:
    secretName: {{ required "database.existingSecret is missing: a secret with the password" $values.database.existingSecret }}
    defaultMode: 0440
    items: [{key: {{ $values.database.passwordKey }}, path: password}]
{{- if $values.store.existingClaim }}
- name: store
  persistentVolumeClaim: {claimName: {{ $values.store.existingClaim }}}
{{- end }}
{{- if and .link $values.workerLink.tlsSecret }}
- name: worker-link
  secret: {secretName: {{ $values.workerLink.tlsSecret }}, defaultMode: 0440}
{{- end }}
{{- if and .link $values.oidc.issuer $values.oidc.existingSecret }}
- name: oidc
  secret:
    secretName: {{ $values.oidc.existingSecret }}
    defaultMode: 0440
    items: [{key: {{ $values.oidc.secretKey }}, path: client-secret}]
{{- end }}
{{- if and .link $values.ray.address }}
- name: ray
  secret: {secretName: {{ $values.ray.authSecret }}, defaultMode: 0440, items: [{key: auth_token, path: token}]}
{{- end }}
{{- end }}

{{- define "lambent.probes" -}}
# Migrations happen at the start. The name in the request is one that every server accepts.
startupProbe:
  httpGet: {path: /healthz, port: http, httpHeaders: [{name: Host, value: localhost}]}
  periodSeconds: 5
  failureThreshold: 120
livenessProbe:
  httpGet: {path: /healthz, port: http, httpHeaders: [{name: Host, value: localhost}]}
  periodSeconds: 10
  timeoutSeconds: 5
  failureThreshold: 6
{{- end }}
