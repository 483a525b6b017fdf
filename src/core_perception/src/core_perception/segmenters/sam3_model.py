# SPDX-License-Identifier: BSD-3-Clause
"""SAM 3 through transformers, behind the side-car's server. torch and transformers are imported when it is made.

Needs Python >= 3.11, torch >= 2.6, torchvision, transformers >= 5.20 and pillow, none of which the robot needs.
Source: Hugging Face transformers, Sam3Model and Sam3Processor. One text is one concept; the image is encoded once and
each class costs the rest of the network.
"""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, List, Sequence, Tuple

from core_perception.json_server import BadRequestError
from core_perception.segmenters.sidecar_server import Found, SegmentRequest, SidecarModel

MASK_THRESHOLD = 0.5
MAX_TEXTS_KEPT = 2000
TINY_IMAGE_PX = 112
TINY_SEED = 0
TINY_LETTERS = tuple(chr(code) for code in range(33, 127))


class Sam3Model(SidecarModel):
    """Answers with one SAM 3."""

    def __init__(self, model, processor, name: str, device: str, random_weights: bool = False):
        """Keep model and processor, on the device; see load and random_tiny.

        Args:
            model: transformers.Sam3Model.
            processor: transformers.Sam3Processor.
            name: told to clients.
            device: of torch, such as ``cuda`` or ``cpu``.
            random_weights: told to clients.
        """
        self.model, self.random_weights = name, random_weights
        self._network, self._processor, self._device = model.to(device).eval(), processor, device
        self._texts: Dict[str, Any] = {}

    @classmethod
    def load(cls, source: str, device: str, half: bool) -> Sam3Model:
        """Load weights.

        Args:
            source: folder of a model, or its name on the hub.
            device: of torch.
            half: in bfloat16, for a GPU.

        Raises:
            OSError: there are none.
        """
        import torch
        from transformers import Sam3Model as Network
        from transformers import Sam3Processor

        kind = torch.bfloat16 if half else torch.float32
        network = Network.from_pretrained(source, dtype=kind)
        return cls(network, Sam3Processor.from_pretrained(source), source, device)

    @classmethod
    def random_tiny(cls, device: str = "cpu") -> Sam3Model:
        """Make one of 0.3 million random weights: everything but the meaning is as with a real one."""
        import torch
        from transformers import Sam3Config, Sam3Processor
        from transformers import Sam3Model as Network

        torch.manual_seed(TINY_SEED)
        network = Network(Sam3Config(**_tiny_config()))
        processor = Sam3Processor(image_processor=_tiny_image_processor(), tokenizer=_tiny_tokenizer())
        return cls(network, processor, "sam3 RANDOM TINY", device, random_weights=True)

    def segment(
        self, request: SegmentRequest, is_time_left: Callable[[], bool]
    ) -> Tuple[Sequence[Found], Sequence[str]]:
        """Encode the image, then look for one class after another while there is time.

        Raises:
            BadRequestError: the image file cannot be read, or has another size than it says.
        """
        import torch

        image = _read_image(request)
        found: List[Found] = []
        evaluated: List[str] = []
        with torch.inference_mode():
            inputs = self._processor(images=image, return_tensors="pt").to(self._device)
            pixels = inputs["pixel_values"].to(next(self._network.parameters()).dtype)
            vision = self._network.get_vision_features(pixel_values=pixels)
            for name in request.classes:
                if not is_time_left():
                    break
                output = self._network(vision_embeds=vision, **self._text(name))
                found += self._instances(output, name, request)
                evaluated.append(name)
        return found, evaluated

    def _text(self, name: str) -> Dict[str, Any]:
        """Encode a class name as words; kept, since every frame asks for the same ones."""
        if name not in self._texts:
            if len(self._texts) >= MAX_TEXTS_KEPT:
                self._texts.clear()
            tokens = self._processor(text=name.replace("_", " "), return_tensors="pt").to(self._device)
            mask = tokens["attention_mask"]
            features = self._network.get_text_features(
                input_ids=tokens["input_ids"], attention_mask=mask, return_dict=True
            )
            self._texts[name] = {"text_embeds": features, "attention_mask": mask}
        return self._texts[name]

    def _instances(self, output, name: str, request: SegmentRequest) -> List[Found]:
        for key in ("pred_logits", "pred_boxes", "pred_masks", "presence_logits"):
            if output[key] is not None:  # of bfloat16, what lies near a threshold would be rounded onto it
                output[key] = output[key].float()
        result = self._processor.post_process_instance_segmentation(
            output, threshold=request.min_score, mask_threshold=MASK_THRESHOLD, target_sizes=[request.size_px]
        )[0]
        masks = result["masks"].to("cpu").numpy().astype(bool)
        scores = result["scores"].to("cpu").float().numpy()
        return [Found(name, float(score), mask) for score, mask in zip(scores, masks) if mask.any()]


def _read_image(request: SegmentRequest):
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(request.file), formats=[request.image_format.upper()]) as file:
            if (file.height, file.width) != request.size_px:  # known before the pixels are unpacked
                raise BadRequestError(f"image: size: got {[file.height, file.width]} in the file")
            return file.convert("RGB")
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError) as error:
        raise BadRequestError(f"image: data: cannot be read ({type(error).__name__})") from None


def _tiny_config() -> Dict[str, Any]:
    small = {"hidden_size": 32, "num_attention_heads": 4, "intermediate_size": 64}
    layered = {**small, "num_layers": 1}
    patches = TINY_IMAGE_PX // 14
    return {
        "vision_config": {
            "backbone_config": {
                **small,
                "model_type": "sam3_vit_model",
                "num_hidden_layers": 2,
                "image_size": TINY_IMAGE_PX,
                "pretrain_image_size": TINY_IMAGE_PX,
                "patch_size": 14,
                "window_size": 4,
                "global_attn_indexes": [1],
            },
            "fpn_hidden_size": 32,
            "backbone_feature_sizes": [[patches * k, patches * k] for k in (4, 2, 1)],
        },
        "text_config": {
            **small,
            "model_type": "clip_text_model",
            "vocab_size": 600,
            "projection_dim": 32,
            "num_hidden_layers": 1,
            "max_position_embeddings": 32,
            "bos_token_id": 2 * len(TINY_LETTERS),
            "eos_token_id": 2 * len(TINY_LETTERS) + 1,
        },
        "geometry_encoder_config": layered,
        "detr_encoder_config": layered,
        "detr_decoder_config": {**layered, "num_queries": 8},
        "mask_decoder_config": {"hidden_size": 32, "num_attention_heads": 4},
    }


def _tiny_image_processor():
    from transformers import Sam3ImageProcessor

    return Sam3ImageProcessor(size={"height": TINY_IMAGE_PX, "width": TINY_IMAGE_PX})


def _tiny_tokenizer():
    """Make a tokenizer of single bytes, with the format of CLIP's."""
    from transformers import CLIPTokenizer

    words = [*TINY_LETTERS, *(letter + "</w>" for letter in TINY_LETTERS), "<|startoftext|>", "<|endoftext|>"]
    with tempfile.TemporaryDirectory() as folder:
        vocabulary, merges = Path(folder) / "vocab.json", Path(folder) / "merges.txt"
        vocabulary.write_text(json.dumps({word: k for k, word in enumerate(words)}), encoding="utf-8")
        merges.write_text("#version: 0.2\n", encoding="utf-8")
        return CLIPTokenizer(str(vocabulary), str(merges), model_max_length=32)
