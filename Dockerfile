# An image with the wheel in dist/, which `make wheel` builds: `docker build -t sweep .`, or for GPUs `docker build --target cuda -t sweep:cuda .`
# CUDA comes with the wheels of JAX: the host needs a driver and NVIDIA's container toolkit (`docker run --gpus all`).
ARG PYTHON=docker.io/library/python:3.13-slim

FROM ${PYTHON} AS base
COPY packaging/install.sh requirements.lock constraints.txt /source/
COPY dist/*.whl /source/dist/
# caches of compiled programs, for whichever user docker is told to run as
ENV PATH=/opt/sweep/bin:$PATH HOME=/home/sweep MPLBACKEND=agg
RUN mkdir --mode=1777 /home/sweep /work
WORKDIR /work
ENTRYPOINT ["sweep"]
CMD ["--help"]

FROM base AS cuda
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
RUN bash /source/install.sh /source /opt/sweep gpu,cluster
USER 1000:1000

FROM base AS cpu
RUN bash /source/install.sh /source /opt/sweep cluster
USER 1000:1000
