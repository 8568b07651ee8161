-- beside that of Dagster, which POSTGRES_DB names; they share table names, so each needs its own
CREATE DATABASE mlflow;
