# The service on a CPU: no torch, no build tools in what runs, no root.
FROM python:3.12-slim AS build
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir --prefix /install --constraint constraints.txt '.[scene,service]'

FROM python:3.12-slim
LABEL org.opencontainers.image.title="SpotLight Runtime" \
      org.opencontainers.image.licenses="Apache-2.0"
COPY --from=build /install /usr/local
RUN useradd --system --uid 10001 --home-dir /data spotlight \
    && install --directory --owner spotlight --mode 0700 /data
USER spotlight
ENV SPOTLIGHT_SERVE_DATA=/data \
    SPOTLIGHT_SERVE_HOST=0.0.0.0 \
    SPOTLIGHT_SERVE_PORT=8471 \
    XDG_CACHE_HOME=/data/cache \
    PYTHONUNBUFFERED=1
VOLUME /data
EXPOSE 8471
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=60s CMD ["python", "-c", \
    "import urllib.request as u; u.urlopen('http://127.0.0.1:8471/v2/health/ready', timeout=4)"]
# Beyond loopback it refuses to start without a key:
#   docker run --rm -v spotlight:/data spotlight keys add shop
ENTRYPOINT ["spotlight-serve"]
