#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Write a vision-language model of about two megabytes, wired by hand, for the release test of the real server.

    PYTHONPATH=.core/llama_server/python make_tiny_vlm.py --out DIR      -> DIR/tiny.gguf, DIR/tiny_mmproj.gguf

It is no judge of scenes: it exists so that pixels, prompt, grammar and sampling of a real llama-server can be tested
end to end without weights from the network. What it says is in tiny_replies.json, chosen by the image's mean colour:

    score_red = R - (G + B) / 2, and so on; grey wins if no score exceeds GREY_SCORE, none if the prompt has no image.

How it is wired:
- Every reply is cut into pieces of text that occur once in the vocabulary, so that the last token alone says where in
  which reply the model is; its successor is a fixed entry of the output matrix.
- The vision tower is one convolution (mean colour scores of a patch); the projector passes them on.
- The one attention layer of the text model looks only at image tokens, and adds their mean scores to the residual
  stream, where they decide which reply follows the prompt.
- Unconstrained, an answer begins with the preface, which is no JSON: only a server that enforces the schema leaves
  it out.
- A reply in three parts repeats its second part without end; when a limit of the schema leaves no room for another
  piece of it, the third part follows. Only such a limit, or one of the request, ends it.
- Wherever the grammar leaves the wired path, closing signs are the first choice, so that JSON gets finished.
"""

import argparse
import json
from pathlib import Path
from typing import Dict, List, Mapping, Sequence, Set, Tuple

import gguf
import numpy as np

GREY_SCORE = 0.2
CONTEXT_TOKENS = 32768

# Rows of the residual stream. STATE_0 and on: one per piece of a reply, one for START, where the answer begins.
CONST, IS_IMAGE, RED, GREEN, BLUE, SAW_IMAGE, SAW_RED, SAW_GREEN, SAW_BLUE, PREFACED, START, STATE_0 = range(12)
COLOURS = ("red", "green", "blue")

HEAD_SIZE = 32
VISION_SIZE = 32
PATCH_PX = 16
IMAGE_PX = 64
IMAGE_GAIN = 10.0  # the mark of an image token, far above its colour scores: its norm hardly depends on the colour
GELU_SHIFT = 4.0  # gelu(x + 4) = x + 4 within 0.004 for |x| <= 1: the projector's activation lets scores pass unchanged
STEP, BRANCH = 40.0, 20.0  # logit per unit state, per unit colour score: what follows a piece outweighs every colour
FALLBACK = {",": 2.0, '"': 3.0, "]": 4.0, "}": 5.0}  # logits where no wired piece is allowed
END_OF_TEXT_FALLBACK, TAIL_FALLBACK = 6.0, 8.0

TEMPLATE = (
    "{% for message in messages %}{{ '<|' + message['role'] + '|>' + message['content'] }}{% endfor %}"
    "{% if add_generation_prompt %}{{ '<|assistant|>' }}{% endif %}"
)
CONTROLS = ("<|system|>", "<|user|>", "<|assistant|>")
UNKNOWN, BEGIN, END = 0, 1, 2


def load_replies(path: Path) -> Tuple[str, Dict[str, List[str]]]:
    """Read the preface and, by key, what the model says: one text of compact JSON, or head, repeated part and tail."""
    content = json.loads(path.read_text(encoding="utf-8"))
    replies = content["replies"].items()
    parts = {key: r if isinstance(r, list) else [json.dumps(r, separators=(",", ":"))] for key, r in replies}
    return content["preface"], parts


def cut(text: str, used: Set[str]) -> List[str]:
    """Cut a text into pieces of at least three characters that are not in `used`, and add them to it."""
    pieces: List[str] = []
    start = 0
    while start < len(text):
        end = start + 3
        while end < len(text) and text[start:end] in used:
            end += 1
        piece = text[start:end]
        while len(piece) < 3 or piece in used:  # the rest of the text: joined to the pieces before it
            last = pieces.pop()
            used.discard(last)
            piece = last + piece
        used.add(piece)
        pieces.append(piece)
        start = end
    return pieces


class Vocabulary:
    """Tokens: bytes, printable characters, control tokens, and the pieces of what the model says."""

    def __init__(self, preface: str, replies: Mapping[str, Sequence[str]]):
        used: Set[str] = set()
        self.preface = cut(preface, used)
        self.replies = {key: [cut(part, used) for part in parts] for key, parts in replies.items()}
        characters = [chr(code) for code in range(0x20, 0x7F)]
        self.chains = [self.preface, *(chain for parts in self.replies.values() for chain in parts)]
        self.pieces = [piece for chain in self.chains for piece in chain]
        kinds = gguf.TokenType
        rows: List[Tuple[str, int, float]] = [
            ("<unk>", kinds.UNKNOWN, 0.0),
            ("<s>", kinds.CONTROL, 0.0),
            ("</s>", kinds.CONTROL, 0.0),
        ]
        rows += [(f"<0x{byte:02X}>", kinds.BYTE, 0.0) for byte in range(256)]
        rows += [(token, kinds.CONTROL, 0.0) for token in CONTROLS]
        rows += [(character, kinds.NORMAL, -1.0) for character in characters]
        rows += [(piece, kinds.NORMAL, -100.0) for piece in self.pieces]
        self.rows = [(text.replace(" ", "\u2581"), kind, score) for text, kind, score in rows]
        self._ids = {text: index for index, (text, _, _) in enumerate(rows)}

    def __len__(self) -> int:
        return len(self.rows)

    def id(self, text: str) -> int:
        return self._ids[text]


def wire_text(vocabulary: Vocabulary) -> Dict[str, np.ndarray]:
    """Weights of the text model: a llama of one layer; one head reads the image, the feed-forward part is zero."""
    state = {piece: STATE_0 + index for index, piece in enumerate(vocabulary.pieces)}
    size = -(-(STATE_0 + len(state)) // HEAD_SIZE) * HEAD_SIZE
    embedding, output = np.zeros((2, len(vocabulary), size), np.float32)
    embedding[:, CONST] = 1.0
    for piece, row in state.items():
        embedding[vocabulary.id(piece), row] = 1.0
    embedding[vocabulary.id("<|assistant|>"), START] = 1.0
    embedding[vocabulary.id(vocabulary.preface[-1]), [START, PREFACED]] = 1.0

    _wire_sequence(output, vocabulary, state)
    _wire_branch(output, vocabulary)
    return {"token_embd.weight": embedding, "output.weight": output, **_image_reader(size)}


def _wire_sequence(output: np.ndarray, vocabulary: Vocabulary, state: Mapping[str, int]) -> None:
    """What follows each piece, and what is chosen where the grammar forbids that."""
    output[END, CONST] = END_OF_TEXT_FALLBACK
    for sign, logit in FALLBACK.items():
        output[vocabulary.id(sign), CONST] = logit
    for chain in vocabulary.chains:
        for piece, following in zip(chain, chain[1:]):
            output[vocabulary.id(following), state[piece]] = STEP
    for parts in vocabulary.replies.values():
        output[END, state[parts[-1][-1]]] = STEP
        if len(parts) > 1:
            head, repeated, tail = parts
            output[vocabulary.id(repeated[0]), [state[head[-1]], state[repeated[-1]]]] = STEP
            output[vocabulary.id(tail[0]), CONST] = TAIL_FALLBACK


def _wire_branch(output: np.ndarray, vocabulary: Vocabulary) -> None:
    """At START: the preface, then the reply of the largest colour score, of grey, or of none without an image."""
    first = {key: vocabulary.id(parts[0][0]) for key, parts in vocabulary.replies.items()}
    for token in first.values():
        output[token, START] = STEP
    for colour, row in zip(COLOURS, (SAW_RED, SAW_GREEN, SAW_BLUE)):
        output[first[colour], row] = BRANCH
    output[first["grey"], SAW_IMAGE] = BRANCH * GREY_SCORE
    output[first["none"], CONST] = 0.5 * BRANCH
    output[first["none"], SAW_IMAGE] = -BRANCH
    preface = vocabulary.id(vocabulary.preface[0])
    output[preface, START] = STEP + 2.0 * BRANCH
    output[preface, PREFACED] = -STEP - 2.0 * BRANCH


def _image_reader(size: int) -> Dict[str, np.ndarray]:
    """The layer: query . key = CONST IS_IMAGE, on the last rotary pair of head 0, which hardly turns in the context."""
    query, key, value, out = np.zeros((4, size, size), np.float32)
    query[HEAD_SIZE - 1, CONST] = 1.0
    key[HEAD_SIZE - 1, IS_IMAGE] = 1.0
    # After the RMS norm an image token has IS_IMAGE = sqrt(size) and its scores times sqrt(size) / IMAGE_GAIN.
    unit = 1.0 / np.sqrt(size)
    value[0, IS_IMAGE] = unit
    for channel, row in enumerate((RED, GREEN, BLUE), start=1):
        value[channel, row] = unit * IMAGE_GAIN
    for channel, row in enumerate((SAW_IMAGE, SAW_RED, SAW_GREEN, SAW_BLUE)):
        out[row, channel] = 1.0
    one, zero = np.ones(size, np.float32), np.zeros((size, size), np.float32)
    layer = {
        "attn_q": query,
        "attn_k": key,
        "attn_v": value,
        "attn_output": out,
        "ffn_gate": zero,
        "ffn_up": zero,
        "ffn_down": zero,
    }
    tensors = {f"blk.0.{name}.weight": matrix for name, matrix in layer.items()}
    return {**tensors, "blk.0.attn_norm.weight": one, "blk.0.ffn_norm.weight": one, "output_norm.weight": one}


def wire_vision(text_size: int) -> Dict[str, np.ndarray]:
    """Weights of vision tower and projector: channel 0 of a patch is 1, channels 1 to 3 are its mean colour scores."""
    score = np.full((3, 3), -0.5, np.float32)
    np.fill_diagonal(score, 1.0)  # red = R - (G + B) / 2
    patch = np.zeros((VISION_SIZE, 3, PATCH_PX, PATCH_PX), np.float32)
    patch[1:4] = score[:, :, None, None] / PATCH_PX**2
    position = np.zeros(((IMAGE_PX // PATCH_PX) ** 2, VISION_SIZE), np.float32)
    position[:, 0] = 1.0
    projector = np.zeros((text_size, VISION_SIZE), np.float32)
    projector[IS_IMAGE, 0] = IMAGE_GAIN
    projector[[RED, GREEN, BLUE], [1, 2, 3]] = 1.0
    square, line = np.zeros((VISION_SIZE, VISION_SIZE), np.float32), np.zeros(VISION_SIZE, np.float32)
    # The one layer is there by the format and never computed: llava takes what enters the last layer.
    layer = ("attn_q", "attn_k", "attn_v", "attn_out", "ffn_up", "ffn_down")
    return {
        "v.patch_embd.weight": patch,
        "v.position_embd.weight": position,
        **{f"v.blk.0.{name}.weight": square for name in layer},
        **{f"v.blk.0.{name}.weight": line + 1.0 for name in ("ln1", "ln2")},
        **{f"v.blk.0.{name}.bias": line for name in ("ln1", "ln2")},
        "mm.0.weight": np.eye(VISION_SIZE, dtype=np.float32),
        "mm.0.bias": line + GELU_SHIFT,
        "mm.2.weight": projector,
        "mm.2.bias": -GELU_SHIFT * projector.sum(axis=1),
    }


def write_text(path: Path, vocabulary: Vocabulary, tensors: Mapping[str, np.ndarray]) -> None:
    writer = gguf.GGUFWriter(path, "llama")
    size = tensors["token_embd.weight"].shape[1]
    writer.add_name("tiny hand-wired test model")
    writer.add_context_length(CONTEXT_TOKENS)
    writer.add_embedding_length(size)
    writer.add_block_count(1)
    writer.add_feed_forward_length(size)
    writer.add_head_count(size // HEAD_SIZE)
    writer.add_rope_dimension_count(HEAD_SIZE)
    writer.add_rope_freq_base(1e10)
    writer.add_layer_norm_rms_eps(1e-6)
    writer.add_vocab_size(len(vocabulary))
    writer.add_tokenizer_model("llama")
    texts, kinds, scores = zip(*vocabulary.rows)
    writer.add_token_list(texts)
    writer.add_token_scores(scores)
    writer.add_token_types(kinds)
    writer.add_unk_token_id(UNKNOWN)
    writer.add_bos_token_id(BEGIN)
    writer.add_eos_token_id(END)
    writer.add_add_space_prefix(False)
    writer.add_chat_template(TEMPLATE)
    _write(writer, tensors, np.float16)


def write_vision(path: Path, text_size: int) -> None:
    writer = gguf.GGUFWriter(path, "clip")
    writer.add_string("clip.projector_type", "mlp")
    writer.add_bool("clip.has_vision_encoder", True)
    writer.add_bool("clip.use_gelu", True)
    sizes = {
        "image_size": IMAGE_PX,
        "patch_size": PATCH_PX,
        "embedding_length": VISION_SIZE,
        "feed_forward_length": VISION_SIZE,
        "block_count": 1,
        "projection_dim": text_size,
        "attention.head_count": 1,
    }
    for name, value in sizes.items():
        writer.add_uint32(f"clip.vision.{name}", value)
    writer.add_float32("clip.vision.attention.layer_norm_epsilon", 1e-6)
    writer.add_array("clip.vision.image_mean", [0.0, 0.0, 0.0])
    writer.add_array("clip.vision.image_std", [1.0, 1.0, 1.0])
    _write(writer, wire_vision(text_size), np.float32)


def _write(writer: gguf.GGUFWriter, tensors: Mapping[str, np.ndarray], dtype: type) -> None:
    for name, tensor in tensors.items():
        writer.add_tensor(name, tensor.astype(dtype) if tensor.ndim > 1 else tensor)
    writer.write_header_to_file()
    writer.write_kv_data_to_file()
    writer.write_tensors_to_file()
    writer.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="directory of the two files")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    vocabulary = Vocabulary(*load_replies(Path(__file__).with_name("tiny_replies.json")))
    tensors = wire_text(vocabulary)
    write_text(out / "tiny.gguf", vocabulary, tensors)
    write_vision(out / "tiny_mmproj.gguf", tensors["token_embd.weight"].shape[1])


if __name__ == "__main__":
    main()
