-- MLflow and Dagster (POSTGRES_DB) use the same table names, so each needs its own database
CREATE DATABASE mlflow;
