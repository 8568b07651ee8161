"""The registered model: MLflow loads this file beside the frozen folder and asks it for probabilities."""

import mlflow
import numpy as np


class HandEnsemble(mlflow.pyfunc.PythonModel):
    """uint8 images (B, H, W, 3) -> p_occupied (B, H, W) float32."""

    def load_context(self, context):  # type: ignore[no-untyped-def]
        import deltasafe

        self.ensemble = deltasafe.load_ensemble(context.artifacts["ensemble"])

    def predict(self, context, model_input: np.ndarray, params=None) -> np.ndarray:  # type: ignore[no-untyped-def,type-arg]
        return np.stack([self.ensemble.p_occupied(image) for image in np.asarray(model_input)])


mlflow.models.set_model(HandEnsemble())
