# The whole of Lambent: server, worker and client in one image, run as an ordinary user. Without TORCH_INDEX it
# has CUDA's libraries and serves for GPUs too.
FROM node:20-slim AS pages
WORKDIR /opt/lambent/client/web
COPY client/web/package.json client/web/package-lock.json ./
RUN npm ci --no-audit --no-fund
COPY client/web ./
RUN npm run build

FROM python:3.11-slim-bookworm

# Triton compiles a few lines of C when it first starts a kernel on a GPU; this Python has its header files.
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev \
    && rm -rf /var/lib/apt/lists/* \
    && echo '#include <Python.h>' \
        | gcc -fsyntax-only -x c -I "$(python -c 'import sysconfig; print(sysconfig.get_path("include"))')" -

RUN useradd --uid 10001 --create-home --shell /usr/sbin/nologin lambent \
    && mkdir /data /store && chown lambent:lambent /data /store
WORKDIR /opt/lambent

# An index with torch's small CPU build; empty takes the registry's build, which is gigabytes larger.
ARG TORCH_INDEX=
COPY constraints.txt ./
RUN if [ -n "$TORCH_INDEX" ]; then \
        pip install --no-cache-dir -c constraints.txt --index-url "$TORCH_INDEX" torch; \
    fi

COPY pyproject.toml README.md LICENSE ./
COPY proto proto
COPY server server
COPY worker worker
COPY client/python client/python
COPY scripts scripts
COPY --from=pages /opt/lambent/client/python/lambent_pages/dist client/python/lambent_pages/dist
# With `ray`, the same image is head and node of a Ray cluster.
ARG EXTRAS=server,s3,oidc,worker,client
RUN pip install --no-cache-dir -c constraints.txt ".[$EXTRAS]"

# Waiting threads sleep. Compiled kernels are kept where the user may write and where files may be executed, which
# Docker forbids on a tmpfs: /data is a volume wherever jobs run.
ENV OMP_WAIT_POLICY=PASSIVE \
    CUDA_CACHE_PATH=/data/cache/cuda \
    NUMBA_CACHE_DIR=/data/cache/numba \
    TRITON_CACHE_DIR=/data/cache/triton \
    PYTHONUNBUFFERED=1
USER 10001:10001
# As Ctrl-C: whoever stops a container gives its runs the time to write a checkpoint.
STOPSIGNAL SIGINT
ENTRYPOINT ["lambent"]
CMD ["--help"]
