# Kennfeld's commands. The first stage builds the wheel; the image holds no sources and no build tools.
#
#   docker build --tag kennfeld .
#   docker run --rm --volume "$PWD:/project" --user "$(id -u):$(id -g)" kennfeld calibrate kennfeld.toml
#
# EXTRAS are those of pyproject.toml: --build-arg EXTRAS=all adds C, ONNX, notebooks and clusters.
ARG PYTHON=3.13

FROM python:${PYTHON}-slim AS build
WORKDIR /source
COPY . .
RUN python -m venv /build \
    && /build/bin/pip install --no-cache-dir "build>=1.2.1" \
    && /build/bin/python -m build --wheel --outdir /dist

FROM python:${PYTHON}-slim
ARG EXTRAS=files
RUN --mount=type=bind,from=build,source=/dist,target=/dist \
    pip install --no-cache-dir "$(echo /dist/kennfeld-*.whl)[${EXTRAS}]" \
    && useradd --create-home --uid 1000 kennfeld \
    && install --directory --owner kennfeld /project
USER 1000
WORKDIR /project
ENTRYPOINT ["kennfeld"]
CMD ["--help"]
