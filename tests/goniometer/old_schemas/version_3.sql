CREATE TABLE about (
    application VARCHAR NOT NULL,
    schema_version INTEGER NOT NULL,
    PRIMARY KEY (application)
);
CREATE TABLE campaigns (
    id INTEGER NOT NULL,
    name VARCHAR NOT NULL,
    json TEXT NOT NULL,
    hash VARCHAR NOT NULL,
    certificate TEXT,
    created VARCHAR NOT NULL,
    PRIMARY KEY (id),
    UNIQUE (name)
);
CREATE TABLE characterisations (
    id INTEGER NOT NULL,
    kind VARCHAR NOT NULL,
    json TEXT NOT NULL,
    software_version VARCHAR NOT NULL,
    created VARCHAR NOT NULL,
    PRIMARY KEY (id)
);
CREATE TABLE datasets (
    id INTEGER NOT NULL,
    scan_id INTEGER NOT NULL,
    sample VARCHAR NOT NULL,
    arrays BLOB NOT NULL,
    checks TEXT NOT NULL,
    lineage TEXT NOT NULL,
    content_hash VARCHAR NOT NULL,
    software_version VARCHAR NOT NULL,
    created VARCHAR NOT NULL,
    PRIMARY KEY (id),
    FOREIGN KEY(scan_id) REFERENCES scans (id)
);
CREATE TABLE exports (
    id INTEGER NOT NULL,
    dataset_id INTEGER NOT NULL,
    path VARCHAR NOT NULL,
    format VARCHAR NOT NULL,
    sha256 VARCHAR NOT NULL,
    created VARCHAR NOT NULL,
    PRIMARY KEY (id),
    FOREIGN KEY(dataset_id) REFERENCES datasets (id)
);
CREATE TABLE exposures (
    id INTEGER NOT NULL,
    scan_id INTEGER NOT NULL,
    point_id INTEGER,
    kind VARCHAR NOT NULL,
    integration_time FLOAT NOT NULL,
    counts BLOB NOT NULL,
    device_count INTEGER NOT NULL,
    detector_temperature FLOAT NOT NULL,
    theta_in FLOAT,
    theta_out FLOAT,
    moment FLOAT NOT NULL,
    taken VARCHAR NOT NULL,
    PRIMARY KEY (id),
    CHECK (kind IN ('light', 'dark', 'stray', 'monitor')),
    CHECK ((kind = 'light') = (point_id IS NOT NULL)),
    CHECK ((kind = 'dark') = (theta_in IS NULL) AND (theta_in IS NULL) = (theta_out IS NULL)),
    FOREIGN KEY(scan_id) REFERENCES scans (id),
    FOREIGN KEY(point_id) REFERENCES points (id)
);
CREATE TABLE fits (
    id INTEGER NOT NULL,
    dataset_id INTEGER NOT NULL,
    model VARCHAR NOT NULL,
    json TEXT NOT NULL,
    software_version VARCHAR NOT NULL,
    created VARCHAR NOT NULL,
    PRIMARY KEY (id),
    FOREIGN KEY(dataset_id) REFERENCES datasets (id)
);
CREATE TABLE points (
    id INTEGER NOT NULL,
    scan_id INTEGER NOT NULL,
    number INTEGER NOT NULL,
    theta_in FLOAT NOT NULL,
    theta_out FLOAT NOT NULL,
    read_theta_in FLOAT,
    read_theta_out FLOAT,
    status VARCHAR NOT NULL,
    attempts INTEGER NOT NULL,
    reason TEXT NOT NULL,
    seconds FLOAT NOT NULL,
    finished VARCHAR,
    PRIMARY KEY (id),
    CHECK (status IN ('pending', 'running', 'done', 'failed', 'skipped')),
    UNIQUE (scan_id, number),
    FOREIGN KEY(scan_id) REFERENCES scans (id)
);
CREATE TABLE scans (
    id INTEGER NOT NULL,
    campaign_id INTEGER NOT NULL,
    number INTEGER NOT NULL,
    kind VARCHAR NOT NULL,
    sample VARCHAR NOT NULL,
    material VARCHAR NOT NULL,
    phase VARCHAR NOT NULL,
    outcome VARCHAR,
    reason TEXT NOT NULL,
    command VARCHAR,
    constants TEXT,
    started VARCHAR,
    finished VARCHAR,
    PRIMARY KEY (id),
    CHECK (kind IN ('reference', 'sample', 'spot')),
    CHECK (phase IN ('idle', 'running', 'pausing', 'paused', 'aborting', 'finished')),
    CHECK (outcome IN ('completed', 'aborted', 'failed')),
    CHECK (command IN ('pause', 'resume', 'abort')),
    UNIQUE (campaign_id, number),
    FOREIGN KEY(campaign_id) REFERENCES campaigns (id)
);
CREATE INDEX exposures_of_scan ON exposures (scan_id);
CREATE TRIGGER characterisations_no_delete BEFORE DELETE ON characterisations BEGIN SELECT RAISE(ABORT, 'characterisations are only ever added'); END;
CREATE TRIGGER characterisations_no_update BEFORE UPDATE ON characterisations BEGIN SELECT RAISE(ABORT, 'characterisations are only ever added'); END;
CREATE TRIGGER datasets_no_delete BEFORE DELETE ON datasets BEGIN SELECT RAISE(ABORT, 'datasets are only ever added'); END;
CREATE TRIGGER datasets_no_update BEFORE UPDATE ON datasets BEGIN SELECT RAISE(ABORT, 'datasets are only ever added'); END;
CREATE TRIGGER exports_no_delete BEFORE DELETE ON exports BEGIN SELECT RAISE(ABORT, 'exports are only ever added'); END;
CREATE TRIGGER exports_no_update BEFORE UPDATE ON exports BEGIN SELECT RAISE(ABORT, 'exports are only ever added'); END;
CREATE TRIGGER exposures_no_delete BEFORE DELETE ON exposures BEGIN SELECT RAISE(ABORT, 'exposures are only ever added'); END;
CREATE TRIGGER exposures_no_update BEFORE UPDATE ON exposures BEGIN SELECT RAISE(ABORT, 'exposures are only ever added'); END;
CREATE TRIGGER fits_no_delete BEFORE DELETE ON fits BEGIN SELECT RAISE(ABORT, 'fits are only ever added'); END;
CREATE TRIGGER fits_no_update BEFORE UPDATE ON fits BEGIN SELECT RAISE(ABORT, 'fits are only ever added'); END;
