"""The committed Python of the message types is what the .proto files say."""

from __future__ import annotations

import importlib.util

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool
from sawbench.storage.codec import MESSAGE_TYPES, schema_data
from sawbench.storage.schemas.generate import PROTO_FILES, generate

pytestmark = pytest.mark.unit


@pytest.mark.skipif(importlib.util.find_spec("grpc_tools") is None, reason="grpcio-tools is not installed")
def test_generated_code_is_up_to_date(tmp_path):
    generate(tmp_path)
    committed = {cls.DESCRIPTOR.file.name: cls.DESCRIPTOR.file.serialized_pb for cls in MESSAGE_TYPES.values()}
    assert len(committed) == len(PROTO_FILES)
    for name, serialized in committed.items():
        text = (tmp_path / name.replace(".proto", "_pb2.py")).read_text()
        argument = text.split("AddSerializedFile(")[1].split(")\n")[0]
        assert eval(argument, {"__builtins__": {}}) == serialized, f"run storage/schemas/generate.py: {name}"


@pytest.mark.parametrize("name", MESSAGE_TYPES)
def test_a_schema_stands_on_its_own(name):
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema_data(name)).file:
        pool.Add(file)
    assert pool.FindMessageTypeByName(name).fields_by_name["stamp"].message_type.full_name == (
        "google.protobuf.Timestamp"
    )
