# ruff: noqa
# fmt: off
import datetime

from google.protobuf import timestamp_pb2 as _timestamp_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class SampleBlock(_message.Message):
    __slots__ = ("stamp", "device", "channel", "unit", "first_index", "start_s", "period_s", "time_s", "values", "raw", "raw_counts", "raw_float", "time_ulp")
    STAMP_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    FIRST_INDEX_FIELD_NUMBER: _ClassVar[int]
    START_S_FIELD_NUMBER: _ClassVar[int]
    PERIOD_S_FIELD_NUMBER: _ClassVar[int]
    TIME_S_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    RAW_COUNTS_FIELD_NUMBER: _ClassVar[int]
    RAW_FLOAT_FIELD_NUMBER: _ClassVar[int]
    TIME_ULP_FIELD_NUMBER: _ClassVar[int]
    stamp: _timestamp_pb2.Timestamp
    device: str
    channel: str
    unit: str
    first_index: int
    start_s: float
    period_s: float
    time_s: _containers.RepeatedScalarFieldContainer[float]
    values: _containers.RepeatedScalarFieldContainer[float]
    raw: _containers.RepeatedScalarFieldContainer[float]
    raw_counts: _containers.RepeatedScalarFieldContainer[int]
    raw_float: _containers.RepeatedScalarFieldContainer[float]
    time_ulp: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, stamp: _Optional[_Union[datetime.datetime, _timestamp_pb2.Timestamp, _Mapping]] = ..., device: _Optional[str] = ..., channel: _Optional[str] = ..., unit: _Optional[str] = ..., first_index: _Optional[int] = ..., start_s: _Optional[float] = ..., period_s: _Optional[float] = ..., time_s: _Optional[_Iterable[float]] = ..., values: _Optional[_Iterable[float]] = ..., raw: _Optional[_Iterable[float]] = ..., raw_counts: _Optional[_Iterable[int]] = ..., raw_float: _Optional[_Iterable[float]] = ..., time_ulp: _Optional[_Iterable[int]] = ...) -> None: ...
