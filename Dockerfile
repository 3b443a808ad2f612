# For a server with NVIDIA GPUs and the NVIDIA Container Toolkit. PyTorch's wheels bring CUDA, so a plain Python image is enough.
#
#   docker build -t morlax .
#   mkdir -p runs
#   docker run --rm --gpus all -v "$PWD/runs:/workspace/runs" -v morlax-cache:/workspace/cache morlax train --env ant
#   docker run --rm --gpus all -v "$PWD/runs:/workspace/runs" -v morlax-cache:/workspace/cache -p 127.0.0.1:8080:8080 morlax explore latest --host 0.0.0.0
#
# The volume morlax-cache keeps compiled kernels: only the first training compiles. For a user whose ID is not 1000, build with
# --build-arg USER_ID=$(id -u). For a driver older than 580, choose a build of PyTorch for an earlier CUDA, such as
# --build-arg TORCH="torch --index-url https://download.pytorch.org/whl/cu126".
FROM python:3.12-slim

# a compiler for Triton, and OpenGL for films
RUN apt-get update \
    && apt-get install -y --no-install-recommends gcc libc6-dev libegl1 libopengl0 libgl1 \
    && rm -rf /var/lib/apt/lists/*

ARG TORCH="torch==2.13.0"
RUN pip install --no-cache-dir $TORCH
RUN --mount=type=bind,target=/src,rw pip install --no-cache-dir '/src[explore,video,onnx,optuna]'

ARG USER_ID=1000
RUN useradd --create-home --uid "$USER_ID" morlax && install -d -o morlax /workspace /workspace/runs /workspace/cache
USER morlax
WORKDIR /workspace
ENV WARP_CACHE_PATH=/workspace/cache/warp TRITON_CACHE_DIR=/workspace/cache/triton XDG_CACHE_HOME=/workspace/cache \
    NVIDIA_DRIVER_CAPABILITIES=all
VOLUME ["/workspace/runs", "/workspace/cache"]
EXPOSE 8080
ENTRYPOINT ["morlax"]
CMD ["--help"]
