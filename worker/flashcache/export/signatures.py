"""The inputs and outputs of a bundle's graphs in words, as the graphs and the reference have them.

Units: positions and distances are in scene units and world coordinates (right-handed, z up); radiance is
linear Rec. 709. Source: docs/reference/graphs.md, whose tables a test compares with these.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import onnx


@dataclass(frozen=True, kw_only=True, slots=True)
class Signature:
    """A sentence for a graph and for each of its inputs and outputs."""

    summary: str
    inputs: Mapping[str, str]
    outputs: Mapping[str, str]


_ORIGIN = "start of the ray, world coordinates, scene units"
_DIRECTION = "unit vector in which the ray travels, world coordinates"
_ALBEDO = "base colour, linear Rec. 709 in [0, 1], before albedo_scale_rgb"
_ROUGHNESS = "square root of the GGX width, [0, 1]"
_METALNESS = "share of metal, [0, 1]"

SIGNATURES: Mapping[str, Signature] = MappingProxyType(
    {
        "gbuffer": Signature(
            summary="camera ray -> surface: means over the ray, undefined where opacity is 0",
            inputs={"origin": _ORIGIN, "direction": _DIRECTION},
            outputs={
                "opacity": "share of the ray's light that the object stops, [0, 1]",
                "distance": "mean distance of the surface along the ray, scene units",
                "normal": "unit vector out of the object, world coordinates",
                "albedo": _ALBEDO,
                "perceptual_roughness": _ROUGHNESS,
                "metalness": _METALNESS,
            },
        ),
        "material": Signature(
            summary="point -> material",
            inputs={"position": "point, world coordinates, scene units"},
            outputs={
                "albedo": _ALBEDO,
                "perceptual_roughness": _ROUGHNESS,
                "metalness": _METALNESS,
                "normal": "unit vector out of the object, world coordinates",
                "opacity": "1 - exp(-density * 0.01 scene units): whether the point is inside the object",
            },
        ),
        "fast_cache": Signature(
            summary="secondary ray -> what it hits, and its radiance under the graph's own light",
            inputs={
                "origin": "surface point plus origin_offset times its normal, world coordinates, scene units",
                "direction": _DIRECTION,
            },
            outputs={
                "radiance": "linear Rec. 709 radiance that arrives from the object, times opacity",
                "opacity": "probability that the ray is blocked, [0, 1]",
                "distance": "mean distance of the hit, scene units; secondary_rays.far where opacity < 0.001",
            },
        ),
        "relight": Signature(
            summary="baked transport of a texel or pixel, and light -> radiance; a formula without weights",
            inputs={
                "transfer_direct": "plane `direct` of the transport, one harmonic coefficient per column",
                "transfer_indirect": "plane `indirect`: column 3 k + c is coefficient k of channel c",
                "visibility": "plane `visibility`, one harmonic coefficient per column",
                "sh_reflect": "harmonics of the mirror direction times the GGX lobe's factor of their band",
                "light_sh": "harmonic coefficients of the light, linear Rec. 709; shared by all rows",
                "albedo_diffuse": "(1 - metalness) albedo, after albedo_scale_rgb",
                "spec_prefiltered": "(F0 scale + bias) times the prefiltered map in the mirror direction",
            },
            outputs={"radiance": "linear Rec. 709 radiance towards the viewer"},
        ),
    }
)
"""By the first part of a graph's name: a fast cache's ends with its light."""


def documented(model: onnx.ModelProto, kind: str) -> onnx.ModelProto:
    """Return `model` with the sentences of the signature `kind`; a name without one is a KeyError."""
    signature = SIGNATURES[kind]
    model.doc_string = model.graph.doc_string = signature.summary
    for infos, texts in ((model.graph.input, signature.inputs), (model.graph.output, signature.outputs)):
        for info in infos:
            info.doc_string = texts[info.name]
    return model
