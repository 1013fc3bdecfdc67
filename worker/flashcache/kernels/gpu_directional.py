"""The integrated directional encoding as Triton kernels, with its gradients by direction and blur.

Term t of degree l and order m is, with T_k the Chebyshev polynomials of z,

    (x + iy)^m  (sum over k of polynomials[k, t] T_k(z))  exp(-rates[t] / kappa)

A program takes a block of directions and all terms: tensors have the axes [BLOCK, WIDTH], and WIDTH is the
number of terms rounded up to a power of two. Nothing but directions and blur is kept for the backward pass.
"""

import math
from typing import Any, NamedTuple

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from flashcache.kernels import gpu
from flashcache.kernels.gpu_kernels import block_of, load_vector

VALUES = 512
"""Terms of a program, those that round up to WIDTH counted: four for each of its threads."""


class Terms(NamedTuple):
    """The constants of the encoding."""

    polynomials: Float[Tensor, "polynomials terms"]
    slopes: Float[Tensor, "polynomials terms"]
    """Coefficients of the derivatives of `polynomials` by z."""
    rates: Float[Tensor, " terms"]
    term_orders: Int[Tensor, " terms"]
    """int32"""


def encode(
    directions: Float[Tensor, "*batch 3"], inverse_concentration: Float[Tensor, "*batch 1"], terms: Terms
) -> Float[Tensor, "*batch encoded"]:
    """Return all real parts, then all imaginary parts; differentiable once by both arguments."""
    blur = inverse_concentration.to(directions.dtype).broadcast_to(*directions.shape[:-1], 1)
    return _Encoded.apply(directions, blur, terms)


class _Encoded(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, directions: Tensor, blur: Tensor, terms: Terms) -> Tensor:
        arrays = directions.detach().contiguous(), blur.detach().contiguous()
        ctx.save_for_backward(*arrays)
        ctx.terms = terms
        encoded = directions.new_empty(*directions.shape[:-1], 2 * len(terms.rates))
        _launch(forward, terms, *arrays, encoded)
        return encoded

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:
        arrays = ctx.saved_tensors
        results = torch.empty_like(arrays[0]), torch.empty_like(arrays[1])
        _launch(backward, ctx.terms, *arrays, gradient.contiguous(), *results)
        return *results, None


def block_sizes(terms: Terms) -> dict[str, int]:
    """Return the sizes that are constants of a kernel for these terms."""
    num_polynomials, num_terms = terms.polynomials.shape
    width = 1 << (num_terms - 1).bit_length()
    sizes = {"TERMS": num_terms, "WIDTH": width, "BLOCK": max(1, VALUES // width)}
    return sizes | {"POLYNOMIALS": num_polynomials, "BITS": (num_polynomials - 1).bit_length()}


def _launch(kernel: Any, terms: Terms, *arrays: Tensor) -> None:
    sizes = block_sizes(terms)
    number = arrays[1].numel()
    gpu.start(kernel, (math.ceil(number / sizes["BLOCK"]),), *arrays, *terms, number, **sizes)


@triton.jit
def _power(x, y, exponent, BITS: tl.constexpr):
    """Return real and imaginary part of (x + iy)^exponent for exponents below 2^BITS."""
    real, imaginary = tl.zeros_like(exponent * x) + 1.0, tl.zeros_like(exponent * x)
    for bit in tl.static_range(BITS):
        wanted = ((exponent >> bit) & 1) > 0
        more = real * x - imaginary * y, real * y + imaginary * x
        real, imaginary = tl.where(wanted, more[0], real), tl.where(wanted, more[1], imaginary)
        x, y = x * x - y * y, 2.0 * x * y
    return real, imaginary


@triton.jit
def _series(coefficients, z, term, exists, TERMS: tl.constexpr, POLYNOMIALS: tl.constexpr):
    """Return the sum over k of coefficients[k, term] T_k(z), by T_(k + 1) = 2 z T_k - T_(k - 1)."""
    before, value = z, tl.zeros_like(z) + 1.0
    total = tl.load(coefficients + term, exists, 0.0) * value
    for k in range(1, POLYNOMIALS):
        # The one before T_0 is T_1 as well: 2 z - z = z.
        before, value = value, 2.0 * z * value - before
        total = tl.fma(tl.load(coefficients + k * TERMS + term, exists, 0.0), value, total)
    return total


@triton.jit(do_not_specialize=("num_directions",))
def forward(
    directions, blur, encoded, polynomials, slopes, rates, term_orders, num_directions,
    TERMS: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
    POLYNOMIALS: tl.constexpr, BITS: tl.constexpr,
):  # fmt: skip
    """Write real and imaginary parts [directions, 2, TERMS]."""
    place, exists = block_of(num_directions, BLOCK)
    term = tl.arange(0, WIDTH)[None, :]
    known = term < TERMS
    x, y, z = load_vector(directions, place, exists)
    rate = tl.load(rates + term, known, 0.0)
    along_z = _series(polynomials, z, term, known, TERMS, POLYNOMIALS)
    attenuated = along_z * tl.exp(-rate * tl.load(blur + place, exists, 0.0))
    real, imaginary = _power(x, y, tl.load(term_orders + term, known, 0), BITS)
    column = place * (2 * TERMS) + term
    tl.store(encoded + column, attenuated * real, exists & known)
    tl.store(encoded + column + TERMS, attenuated * imaginary, exists & known)


@triton.jit(do_not_specialize=("num_directions",))
def backward(
    directions, blur, by_encoded, by_directions, by_blur, polynomials, slopes, rates, term_orders,
    num_directions, TERMS: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
    POLYNOMIALS: tl.constexpr, BITS: tl.constexpr,
):  # fmt: skip
    """Write the gradients by directions [directions, 3] and by blur [directions]."""
    place, exists = block_of(num_directions, BLOCK)
    term = tl.arange(0, WIDTH)[None, :]
    known = term < TERMS
    x, y, z = load_vector(directions, place, exists)
    order = tl.load(term_orders + term, known, 0)
    rate = tl.load(rates + term, known, 0.0)
    attenuation = tl.exp(-rate * tl.load(blur + place, exists, 0.0))
    column = place * (2 * TERMS) + term
    of_real = attenuation * tl.load(by_encoded + column, exists & known, 0.0)
    of_imaginary = attenuation * tl.load(by_encoded + column + TERMS, exists & known, 0.0)
    along_z = _series(polynomials, z, term, known, TERMS, POLYNOMIALS)
    # d (x + iy)^m = m (x + iy)^(m - 1) (dx + i dy)
    real, imaginary = _power(x, y, tl.maximum(order - 1, 0), BITS)
    factor = order.to(tl.float32) * along_z
    of_x = factor * (of_real * real + of_imaginary * imaginary)
    of_y = factor * (of_imaginary * real - of_real * imaginary)
    tl.store(by_directions + place * 3, tl.sum(of_x, 1, keep_dims=True), exists)
    tl.store(by_directions + place * 3 + 1, tl.sum(of_y, 1, keep_dims=True), exists)
    whole = order > 0
    real, imaginary = (
        tl.where(whole, real * x - imaginary * y, 1.0),
        tl.where(whole, real * y + imaginary * x, 0.0),
    )
    around = of_real * real + of_imaginary * imaginary
    of_z = around * _series(slopes, z, term, known, TERMS, POLYNOMIALS)
    tl.store(by_directions + place * 3 + 2, tl.sum(of_z, 1, keep_dims=True), exists)
    tl.store(by_blur + place, -tl.sum(around * along_z * rate, 1, keep_dims=True), exists)
