# alula with all extras: docker build -t alula . && docker run --rm -v "$PWD:/work" alula import-splat garden.ply -o garden.scene.npz
FROM python:3.11-slim-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends g++ git && rm -rf /var/lib/apt/lists/*
COPY . /source
WORKDIR /source
RUN pip wheel --no-cache-dir --no-deps -w /wheels .

FROM python:3.11-slim-bookworm
RUN apt-get update \
    && apt-get install -y --no-install-recommends libusb-1.0-0 libegl1 libx11-6 libgl1 libgomp1 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /wheels /wheels
COPY .ci/runtime.lock /runtime.lock
RUN pip install --no-cache-dir --require-hashes -r /runtime.lock \
    && pip install --no-cache-dir --no-deps /wheels/*.whl && rm -rf /wheels
WORKDIR /work
ENTRYPOINT ["alula"]
CMD ["--help"]
