"""What a SpotLight graph and backbone are, as data: contracts, constants, manifests."""

from spotlight_spec.backbone import BackboneSpec, LatentSpec, MapSpec, ScheduleSpec, ShadingSpec
from spotlight_spec.catalogue import BACKBONES
from spotlight_spec.files import alone_in, replacing
from spotlight_spec.graph import (
    GraphContract,
    GraphLayout,
    TensorSpec,
    graph_contracts,
    intrinsics_contract,
)
from spotlight_spec.manifest import (
    MANIFEST_NAME,
    FileEntry,
    Manifest,
    ParityRow,
    Precision,
    Source,
    sha256_of,
)
from spotlight_spec.records import RecordError, decode, encode, read_json, write_json

__all__ = [
    "BACKBONES",
    "MANIFEST_NAME",
    "BackboneSpec",
    "FileEntry",
    "GraphContract",
    "GraphLayout",
    "LatentSpec",
    "Manifest",
    "MapSpec",
    "ParityRow",
    "Precision",
    "RecordError",
    "ScheduleSpec",
    "ShadingSpec",
    "Source",
    "TensorSpec",
    "alone_in",
    "decode",
    "encode",
    "graph_contracts",
    "intrinsics_contract",
    "read_json",
    "replacing",
    "sha256_of",
    "write_json",
]
