"""The paper's prediction network (section V-B): the next range image from the decoded ones before it."""

from __future__ import annotations

from salpcc.stages.predict.paper.st_lstm.predictor import Memory, Model, Prediction, load_model, predict_frame

__all__ = ["Memory", "Model", "Prediction", "load_model", "predict_frame"]
