"""Code of the registered model: MLflow loads this file together with the frozen ensemble."""

import mlflow
import numpy as np


class OccupancyEnsemble(mlflow.pyfunc.PythonModel):
    """Predicts p_occupied (B, H, W) float32 from images (B, H, W, 3) uint8."""

    def load_context(self, context):  # type: ignore[no-untyped-def]
        import deltasafe

        self.ensemble = deltasafe.load_ensemble(context.artifacts["ensemble"])

    def predict(self, context, model_input: np.ndarray, params=None):  # type: ignore[no-untyped-def]
        images = model_input["images"] if isinstance(model_input, dict) else model_input
        return np.stack([self.ensemble.p_occupied(image) for image in np.asarray(images)])


mlflow.models.set_model(OccupancyEnsemble())
