/**
 * The documents and routes of the daemon. Made of its /openapi.json by `npm run schema`: not to be
 * edited by hand.
 */

export interface paths {
    "/": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** The viewer, a page */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description text/html */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/html": string;
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/healthz": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Whether the process answers */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description text/plain */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/plain": string;
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/metrics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Measurements in Prometheus' text format */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description text/plain */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/plain": string;
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/openapi.json": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** This description */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/json */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": string;
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/readyz": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Whether new work is welcome */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description text/plain */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/plain": string;
                    };
                };
                /** @description Shutting down */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** List the sessions, page by page, in the order in which they were opened */
        get: {
            parameters: {
                query?: {
                    /** @description begin behind this session */
                    after?: string;
                    /** @description most sessions on the page */
                    limit?: string;
                };
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description SessionList */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SessionList"];
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        /** Open a session and begin to build its body */
        post: {
            parameters: {
                query?: {
                    /** @description hold the answer until the build has ended, at most so many seconds */
                    wait_s?: string;
                };
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["SessionConfig"];
                    "multipart/form-data": {
                        config: components["schemas"]["SessionConfig"];
                        /** Format: binary */
                        mesh: string;
                    };
                };
            };
            responses: {
                /** @description SessionInfo */
                202: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SessionInfo"];
                    };
                };
                /** @description Malformed mesh file; Malformed parameter; Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible mesh; Impossible configuration; Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description As many as allowed exist; Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Describe a session */
        get: {
            parameters: {
                query?: {
                    /** @description hold the answer until its body is there, at most so many seconds */
                    wait_s?: string;
                };
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description SessionInfo */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SessionInfo"];
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        /** End a session and everything that runs for it */
        delete: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description Done */
                204: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content?: never;
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/edits": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Edit the body: makes the next generation; going away cancels */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["EditRequest"];
                };
            };
            responses: {
                /** @description EditReply */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["EditReply"];
                    };
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not the current generation; The session is not ready; The work was cancelled; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible edit; Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/evaluate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Energy, force and tangent stiffness of the reduced model */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["EvaluateRequest"];
                };
            };
            responses: {
                /** @description EvaluateReply */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["EvaluateReply"];
                    };
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/events": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Follow a session: one Event document in each server-sent event */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description text/event-stream */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/event-stream": string;
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/fork": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Open a session with the same generations, sharing every artifact */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["ForkRequest"];
                };
            };
            responses: {
                /** @description SessionInfo */
                201: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SessionInfo"];
                    };
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description As many as allowed exist; Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/basis": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Basis U with UᵀMU = I: (r, n_vertices, 3) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/combination": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** The basis as D · W of named blocks of columns that generations share: names, columns in use, W, and the names of the blocks prepared for further edits */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/delta": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** The columns that a holder of an older basis lacks, and W: new = [old | columns] · W */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                    /** @description the older generation that the client holds (required) */
                    have?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/dictionary": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** The columns of some blocks of a combination: (columns, n_vertices, 3) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                    /** @description names of the blocks, between commas, as the combination has them (required) */
                    blocks?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such block of columns; No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/evaluate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Energy, force and tangent stiffness of the reduced model */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["EvaluateRequest"];
                };
            };
            responses: {
                /** @description EvaluateReply */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["EvaluateReply"];
                    };
                };
                /** @description Malformed parameter; Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/evaluator": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** All that a client needs to evaluate and step the reduced model alone */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/frequencies_hz": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Frequencies of the elastic modes in Hz, ascending: (n_modes,) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/mass": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Lumped mass of each vertex in kg: (n_vertices,) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/modes": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Linear modes, mass-normalised: (n_modes, n_vertices, 3) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/positions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Rest position of each vertex in m, which a closing moves: (n_vertices, 3) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/stitches": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** The stitches in force: their vertices, their names and their stiffness */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/tets": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Corners of each tet, u32: (n_tets, 4) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/generations/{generation}/transfer": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** From an older generation's coordinates to these: (r_new, r_old) */
        get: {
            parameters: {
                query?: {
                    /** @description f32 (default) or f64 */
                    dtype?: string;
                    /** @description the older generation; by default the previous one */
                    from?: string;
                };
                header?: never;
                path: {
                    id: string;
                    generation: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/x-npy or application/vnd.sutura.frame */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-npy": string;
                        "application/vnd.sutura.frame": string;
                    };
                };
                /** @description Malformed parameter */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session; No such generation */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Not acceptable */
                406: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/seams": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Name candidate pairs: they are prepared in the background */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["SeamRequest"];
                };
            };
            responses: {
                /** @description SeamReply */
                202: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SeamReply"];
                    };
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large; Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible configuration */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/simulation": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Describe the session's simulation */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description SimulationInfo */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SimulationInfo"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No simulation; No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible simulation */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /** Start the session's simulation, or change how it goes on */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["SimulationConfig"];
                };
            };
            responses: {
                /** @description SimulationInfo */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SimulationInfo"];
                    };
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The session is not ready; Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible simulation; Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description As many as allowed exist; Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        /** End the session's simulation */
        delete: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description Done */
                204: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content?: never;
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No simulation; No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/simulation/forces": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Let forces act on vertices for some time */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["ForceRequest"];
                };
            };
            responses: {
                /** @description Done */
                204: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content?: never;
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No simulation; No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/simulation/grabs": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Take hold of vertices, move what holds on, and let go */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["GrabRequest"];
                };
            };
            responses: {
                /** @description Done */
                204: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content?: never;
                };
                /** @description Malformed document */
                400: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No simulation; No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description The request took too long to arrive */
                408: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too large */
                413: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Unsupported media type */
                415: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Impossible value */
                422: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description As many as allowed exist; Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No room to keep it */
                507: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/v1/sessions/{id}/stream": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Receive published states: one binary WebSocket message each */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    id: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description application/vnd.sutura.state */
                101: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/vnd.sutura.state": string;
                    };
                };
                /** @description No valid key */
                401: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Forbidden */
                403: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description No such session */
                404: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Another daemon serves the session */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description WebSocket upgrade required */
                426: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too many requests */
                429: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                /** @description Too busy; The storage failed */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
}
export type webhooks = Record<string, never>;
export interface components {
    schemas: {
        /** @description The basis of the reduced model. */
        BasisConfig: {
            /**
             * @description The lowest so many modes contribute all their pairwise derivatives. Default: 8.
             * @default 8
             */
            n_derivative_modes?: number;
            /**
             * @description How the columns are chosen among modes and derivatives. Default: `snapshots`.
             * @default snapshots
             */
            pca?: components["schemas"]["PcaConfig"];
            /**
             * @description Columns of the basis. Default: 60.
             * @default 60
             */
            size?: number;
        };
        /** @description What a generation claims of itself, estimated from residuals. */
        Certificate: {
            /**
             * Format: double
             * @description Estimated sine of the largest angle between the lower half of the modes and the exact ones.
             */
            basis_angle: number;
            /**
             * Format: double
             * @description Relative reduced-force error of the cubature on poses held out; `null` when every tet is summed.
             */
            cubature_error?: number | null;
            /** @description Whether eigenvalues and cubature are within their tolerances. */
            is_met: boolean;
            /** @description Whether the deadline left something undone, which follows in the background. */
            is_unfinished: boolean;
            /**
             * Format: double
             * @description Largest estimated relative eigenvalue error in the lower half of the modes.
             */
            lower_eigenvalue_error: number;
            /**
             * Format: double
             * @description The same in the upper half, of which a hundred times the tolerance is asked.
             */
            upper_eigenvalue_error: number;
            /** @description Where the modes come from. */
            verdict: components["schemas"]["Verdict"];
        };
        /** @description What a closing ([`Edit::Close`]) did. */
        Closing: {
            /**
             * Format: double
             * @description Strain energy of the closed shape in J, which is dropped: that shape counts as free of stress.
             */
            dropped_energy_j: number;
            /** @description The edit's place in its request. */
            edit: number;
            /** @description For each of its pairs the gap in m that the springs left; the pair was moved the rest of the way. */
            gaps_m: number[];
            /**
             * Format: double
             * @description The largest displacement of a vertex in m.
             */
            largest_displacement_m: number;
            /**
             * Format: double
             * @description Imbalance of the forces at the end, relative to those that pulled.
             */
            residual: number;
        };
        /** @description How obstacles push back at the vertices of the surface. */
        ContactConfig: {
            /**
             * Format: double
             * @description Speed in m/s below which friction grows with the speed: what sticks creeps. Default: a hundredth
             *     of the body's size a second.
             * @default null
             */
            creep_m_s?: number | null;
            /**
             * Format: double
             * @description At 1 m/s into the obstacle the pressure grows by this fraction. Default: 1.
             * @default 1
             */
            damping_s_m?: number;
            /**
             * Format: double
             * @description Coulomb's coefficient of friction. Default: 0.3.
             * @default 0.3
             */
            friction?: number;
            /**
             * Format: double
             * @description Pressure for each metre of depth, in Pa/m. Default: the stiffest Young's modulus over a tenth of the
             *     body's size.
             * @default null
             */
            stiffness_pa_m?: number | null;
        };
        /** @description One vector of reduced coordinates, or several. */
        Coordinates: number[] | number[][];
        /** @description Cubature training. */
        CubatureConfig: {
            /**
             * @description Most points that may be chosen. Default: 120.
             * @default 120
             */
            n_points?: number;
            /**
             * @description Poses to fit. Default: 100.
             * @default 100
             */
            n_training_poses?: number;
            /**
             * Format: int64
             * @description Seed of the poses and of the candidates. Default: 1.
             * @default 1
             */
            seed?: number;
            /**
             * @description How points are chosen. Default: `greedy_nnls`.
             * @default greedy_nnls
             */
            selection?: components["schemas"]["SelectionConfig"];
            /**
             * @description Whether, where the tolerance is not met otherwise, each point may take of the strain of its tet's neighbours as
             *     much as the poses say: half the error with as many points, for longer training. `false`: points are tets, as in
             *     the papers. Default: `true`.
             * @default true
             */
            smoothing?: boolean;
            /**
             * Format: double
             * @description Relative reduced-force error at which training stops. Default: 0.05.
             * @default 0.05
             */
            tolerance?: number;
        };
        /** @description What is known of a generation's cubature rule. */
        CubatureInfo: {
            /** @description Points with positive weight. */
            n_points: number;
            /** @description Where the rule came from. */
            source: components["schemas"]["CubatureSource"];
            /**
             * Format: double
             * @description Relative reduced-force error on poses not used for fitting.
             */
            validation_error: number;
        };
        /**
         * @description Where a cubature rule came from.
         * @enum {string}
         */
        CubatureSource: "reused" | "refitted" | "retrained";
        /** @description Rayleigh damping D = α M + β K. */
        DampingConfig: {
            /**
             * Format: double
             * @description α in 1/s. Default: 0.1.
             * @default 0.1
             */
            rayleigh_mass_per_s?: number;
            /**
             * Format: double
             * @description β in s. Default: 0.001.
             * @default 0.001
             */
            rayleigh_stiffness_s?: number;
        };
        /** @description One change. */
        Edit: {
            /** @description Join pairs of co-located vertices by zero-length springs. */
            stitch: {
                /** @description Vertex pairs (zero-based). */
                pairs: number[][];
                /**
                 * Format: double
                 * @description Stiffness of each spring in N/m.
                 */
                stiffness_n_m: number;
            };
        } | {
            /** @description Remove stitches. */
            unstitch: {
                /** @description The stitches' names, from an [`EditReply`]. */
                stitch_ids: number[];
            };
        } | {
            /** @description Remove every stitch. */
            unstitch_all: Record<string, never>;
        } | {
            /** @description Give stitches another stiffness; they keep their names. */
            set_stiffness: {
                /**
                 * Format: double
                 * @description Stiffness of each spring from now on, in N/m.
                 */
                stiffness_n_m: number;
                /** @description The stitches' names, from an [`EditReply`]. */
                stitch_ids: number[];
            };
        } | {
            /** @description Multiply the stiffness of a domain. */
            scale_stiffness: {
                /**
                 * Format: int64
                 * @description The domain's label.
                 */
                domain: number;
                /**
                 * Format: double
                 * @description The factor, relative to the stiffness in force.
                 */
                factor: number;
            };
        } | {
            /**
             * @description Hold vertices where they rest. A stitch both of whose ends are held stays, without effect
             *     until one of them is released. Changes the free degrees of freedom, so the body is factorized
             *     anew (unless a kept generation holds just the same vertices).
             */
            fix: {
                /** @description The vertices, none of them held yet (zero-based). */
                vertices: number[];
            };
        } | {
            /**
             * @description Let vertices move that were held, by the session's configuration or by an edit. What nothing
             *     holds any longer floats, with rigid modes. Costs what `fix` costs.
             */
            release: {
                /** @description The vertices, each of them held (zero-based). */
                vertices: number[];
            };
        } | {
            /**
             * @description Pull pairs of vertices together that do not coincide, and stitch them.
             *
             *     The whole body, with its nonlinear material, is brought into static equilibrium under springs
             *     between the vertices of each pair (and of every stitch in force, so that what was closed stays
             *     so), which grow as stiff as it takes. The shape in which the pairs meet becomes the rest shape
             *     of the body, prepared anew: fetch `positions` and `mass`. It counts as free of stress; the
             *     strain energy that is dropped so is reported. Displacements (of a running simulation, too) count
             *     from the new rest shape. Seams and other vertices that coincided may no longer do so. A gap that
             *     remains too wide, because of supports or because tets would be crushed, is a 422 that names it,
             *     and nothing is changed.
             */
            close: {
                /**
                 * Format: double
                 * @description The widest gap accepted, in m: pairs that come as near are moved the rest of the way. Default:
                 *     1e-4 of the diagonal of the body's bounding box, about a hundredth of a tet's edge.
                 */
                max_gap_m?: number | null;
                /** @description Vertex pairs (zero-based). */
                pairs: number[][];
                /**
                 * Format: double
                 * @description Stiffness in N/m of each stitch, once its pair is closed.
                 */
                stiffness_n_m: number;
            };
        };
        /**
         * @description Which modal derivatives the basis gets after an edit inside a seam: `prepared`, what can be combined of those of
         *     the open and of the closed seam, without a solve; or `own`, those of the stitched body, solved for where its modes
         *     differ from theirs by more than 0.1 %, as they may where a part of the seam is stitched. A warning tells of 3 % where
         *     they are not solved for.
         * @enum {string}
         */
        EditDerivatives: "prepared" | "own";
        /**
         * @description How the linear modes follow an edit.
         * @enum {string}
         */
        EditMethod: "flexibility" | "low_rank" | "from_scratch";
        /** @description What an edit made. */
        EditReply: {
            /** @description Columns of the basis. */
            basis_size: number;
            /** @description How good the answer is, and how that is known. */
            certificate: components["schemas"]["Certificate"];
            /** @description What each closing did, in the order of the request. */
            closings: components["schemas"]["Closing"][];
            cubature?: components["schemas"]["CubatureInfo"] | null;
            /** @description Eigenvalues λ = ω² of the elastic modes in 1/s², ascending. */
            eigenvalues_per_s2: number[];
            /** @description Frequencies √λ/2π of the elastic modes in Hz. */
            frequencies_hz: number[];
            /**
             * Format: int64
             * @description The new generation.
             */
            generation: number;
            /** @description How the linear modes followed. */
            method: components["schemas"]["EditMethod"];
            /** @description Rigid motions that cost no energy, with the stitches in force. */
            n_rigid_modes: number;
            /** @description Stitches in force. */
            n_stitches: number;
            /** @description The relative residual of each mode. */
            residuals: number[];
            /** @description Names of the stitches made, in the order of the request's pairs. */
            stitch_ids: number[];
            /** @description Time spent, in ms. */
            timings_ms: components["schemas"]["EditTimings"];
            /** @description What the caller should know, in words. */
            warnings: string[];
        };
        /** @description Changes that take effect together or not at all. */
        EditRequest: {
            /**
             * Format: int64
             * @description The generation the edit was made for; refused with 409 if it is no longer the current one.
             */
            base_generation?: number | null;
            /**
             * Format: double
             * @description Time in ms, from when the request comes, in which to answer with the best that fits: time spent
             *     waiting for a turn leaves less for the edit. What it leaves undone follows in the background,
             *     as a further generation that counts as this one in `base_generation`. Without it the answer is
             *     finished, however long that takes (`flexibility` only).
             */
            deadline_ms?: number | null;
            /**
             * @description Which modal derivatives the basis gets after an edit inside a seam (`flexibility` only). Default:
             *     `prepared`.
             */
            derivatives?: components["schemas"]["EditDerivatives"];
            /** @description The changes, applied in order; at least one, unless `restore` is given. */
            edits: components["schemas"]["Edit"][];
            /** @description How the linear modes follow. Default: `flexibility`. */
            method?: components["schemas"]["EditMethod"];
            /**
             * Format: int64
             * @description A generation that the session still keeps, to return to first: undo and redo. Without edits
             *     the next generation is that one again, at no cost.
             */
            restore?: number | null;
            /**
             * Format: double
             * @description Relative eigenvalue error accepted in the lower half of the modes (`flexibility` only).
             *     Default: 1e-4.
             */
            tolerance?: number;
        };
        /** @description Time spent in an edit, in ms. */
        EditTimings: {
            /**
             * Format: double
             * @description Closing of pairs that did not coincide.
             */
            closing: number;
            /**
             * Format: double
             * @description Cubature reuse, validation, fitting.
             */
            cubature: number;
            /**
             * Format: double
             * @description Modal derivatives.
             */
            derivatives: number;
            /**
             * Format: double
             * @description Linear modes, with the factorization and seam columns where those were redone.
             */
            linear: number;
            /**
             * Format: double
             * @description Basis and reduced tables.
             */
            reduction: number;
            /** @description Every stage by its own name. */
            stages: {
                [key: string]: number;
            };
            /**
             * Format: double
             * @description From the command's start to the new generation.
             */
            total: number;
        };
        /** @description The answer: one evaluation for one vector, a list for a batch. */
        EvaluateReply: components["schemas"]["Evaluation"] | {
            /** @description One for each vector. */
            evaluations: components["schemas"]["Evaluation"][];
        };
        /** @description Where to evaluate. */
        EvaluateRequest: {
            /** @description Sum over every tet instead of the cubature points. Default: false. */
            exact?: boolean;
            /** @description Reduced coordinates: `basis_size` numbers, or a list of such vectors. */
            q: components["schemas"]["Coordinates"];
        };
        /** @description Energy, force and tangent stiffness in reduced coordinates. */
        Evaluation: {
            /**
             * Format: double
             * @description Strain energy in J, stitches included.
             */
            energy_j: number;
            /** @description Reduced internal force +∂Ψ/∂q. */
            force: number[];
            /** @description Rows of the reduced tangent stiffness. */
            stiffness: number[][];
        };
        /**
         * @description One server-sent event. `event:` carries [`Event::name`], `data:` this document. The first event
         *     of every stream is a `state`.
         */
        Event: {
            /** @enum {string} */
            event: "state";
            /**
             * Format: int64
             * @description The current generation.
             */
            generation: number;
            /** @description What it is doing. */
            state: components["schemas"]["SessionState"];
        } | {
            /** @enum {string} */
            event: "stage";
            /**
             * Format: double
             * @description How much of it is done, 0 to 1.
             */
            progress: number;
            /** @description The stage. */
            stage: string;
        } | (components["schemas"]["GenerationInfo"] & {
            /** @enum {string} */
            event: "generation";
        }) | {
            /** @enum {string} */
            event: "simulation";
            /** @description Whether one is running now. */
            running: boolean;
        } | {
            /** @description Why. */
            error: components["schemas"]["Problem"];
            /** @enum {string} */
            event: "failed";
        } | {
            /** @enum {string} */
            event: "deleted";
        };
        /** @description A force on one vertex for some time. */
        Force: {
            /**
             * Format: double
             * @description For how long, in s of simulated time.
             */
            duration_s: number;
            /** @description The force in N. */
            force_n: number[];
            /**
             * Format: int32
             * @description The vertex (zero-based).
             */
            vertex: number;
        };
        /** @description Forces to be added to those already acting. */
        ForceRequest: {
            /** @description The forces. */
            forces: components["schemas"]["Force"][];
        };
        /** @description How a fork differs from its origin. A request without a body differs in nothing. */
        ForkRequest: {
            /**
             * @description The new session's name; without it, the origin's.
             * @default null
             */
            name?: string | null;
        };
        /** @description A new generation; also what Zenoh's `generation` publication carries, as JSON. */
        GenerationInfo: {
            /** @description Columns of the basis. */
            basis_size: number;
            /**
             * Format: int64
             * @description The generation.
             */
            generation: number;
            /** @description Elastic modes kept. */
            n_modes: number;
            /** @description Stitches in force. */
            n_stitches: number;
        };
        /** @description A damped spring from a vertex to a point in the world: a hand, or a surgical tool. */
        Grab: {
            /**
             * Format: double
             * @description Damping in N·s/m. Default: 0.
             */
            damping_n_s_m?: number;
            /**
             * Format: int64
             * @description The grab's name, for the caller to choose.
             */
            id: number;
            /**
             * Format: double
             * @description Stiffness in N/m.
             */
            stiffness_n_m: number;
            /** @description Where it is pulled to, in m. */
            target_m: number[];
            /**
             * Format: int32
             * @description The vertex (zero-based).
             */
            vertex: number;
        };
        /** @description Vertices to be held on to, and grabs to be let go. */
        GrabRequest: {
            /**
             * @description Grabs that take hold; one of the name of an earlier one takes its place, so that a tool is moved by
             *     sending its grab again.
             * @default []
             */
            grabs?: components["schemas"]["Grab"][];
            /**
             * @description Names of grabs that let go; those that are not there are passed over.
             * @default []
             */
            release?: number[];
        };
        /**
         * @description How the reduced equations of motion are integrated.
         * @enum {string}
         */
        IntegratorConfig: "implicit_newmark" | "backward_euler" | "modal_oscillators" | "quasi_static";
        /**
         * @description How mass is distributed.
         * @enum {string}
         */
        MassConfig: "lumped" | "consistent";
        /** @description A material. */
        MaterialConfig: {
            /**
             * Format: double
             * @description Density in kg/m³.
             */
            density_kg_m3: number;
            /** @description The constitutive law. */
            law: components["schemas"]["MaterialLaw"];
            /**
             * Format: double
             * @description C₀₁/(C₁₀ + C₀₁), 0 to 1, of a `mooney_rivlin` material. Default: 0.2.
             */
            mooney_ratio?: number | null;
            /**
             * Format: double
             * @description Poisson's ratio, strictly between −1 and 0.5.
             */
            poisson_ratio: number;
            /**
             * Format: double
             * @description Young's modulus in Pa.
             */
            young_modulus_pa: number;
        };
        /**
         * @description A constitutive law.
         * @enum {string}
         */
        MaterialLaw: "linear" | "stvk" | "neo_hookean" | "mooney_rivlin" | "corotational";
        /** @description A tetrahedral mesh, inline. */
        MeshConfig: {
            /** @description The domain label of each tet; empty for a single domain 0. */
            domains?: number[];
            /** @description Corners of each tet (zero-based), positively oriented. */
            tets: number[][];
            /** @description Rest positions in metres. */
            vertices: number[][];
        };
        /** @description Something rigid that the body cannot enter, at rest in the world until a simulation is changed. */
        Obstacle: {
            /** @description Everything on the far side of a plane. */
            plane: {
                /** @description The side on which the body may be; any length but zero. */
                normal: number[];
                /** @description A point of the plane, in m. */
                point_m: number[];
            };
        } | {
            /** @description A ball. */
            sphere: {
                /** @description Its centre, in m. */
                center_m: number[];
                /**
                 * Format: double
                 * @description Its radius, in m.
                 */
                radius_m: number;
            };
        } | {
            /** @description All points within a radius of a line segment. */
            capsule: {
                /** @description One end of the segment, in m. */
                from_m: number[];
                /**
                 * Format: double
                 * @description Its radius, in m.
                 */
                radius_m: number;
                /** @description The other end, in m. */
                to_m: number[];
            };
        };
        /**
         * @description How principal components in the mass inner product are found.
         * @enum {string}
         */
        PcaConfig: "snapshots" | "randomized";
        /** @description An RFC 9457 problem document (`application/problem+json`). */
        Problem: {
            /** @description What happened this time: names the offending vertex, tet, member or limit. */
            detail: string;
            /** @description JSON pointer (RFC 6901) into the request, where one input is at fault. */
            instance_pointer?: string | null;
            /**
             * Format: int32
             * @description The HTTP status, over Zenoh too.
             */
            status: number;
            /** @description The kind of problem in words. */
            title: string;
            /** @description A URI that names the kind of problem. */
            type: string;
        };
        /** @description What a session has of candidate pairs. */
        SeamReply: {
            /** @description Pairs named, when the session was opened and since. */
            n_pairs: number;
            /** @description Those prepared so far, stitched ones included. */
            n_prepared_pairs: number;
        };
        /** @description Names candidate pairs, which are then prepared in the background. */
        SeamRequest: {
            /** @description Pairs of co-located vertices (zero-based) that may be stitched later. */
            pairs: number[][];
        };
        /**
         * @description How cubature points are chosen among the tets.
         * @enum {string}
         */
        SelectionConfig: "greedy_nnls" | "nn_htp" | "sparse_nnls" | "empirical_cubature";
        /**
         * @description What a session is made from. The mesh is either inline (`mesh`, in a JSON request) or a file
         *     (the `mesh` part of a multipart request, which leaves this member out).
         */
        SessionConfig: {
            /** @description The basis of the reduced model. */
            basis?: components["schemas"]["BasisConfig"];
            cubature?: components["schemas"]["CubatureConfig"] | null;
            /** @description Rayleigh damping. */
            damping?: components["schemas"]["DampingConfig"];
            /** @description Materials of single domains, by label. */
            domain_materials?: {
                [key: string]: components["schemas"]["MaterialConfig"];
            };
            /** @description Vertices that never move (zero-based). */
            fixed_vertices?: number[];
            /** @description How mass is distributed. Default: `lumped`. */
            mass?: components["schemas"]["MassConfig"];
            material?: components["schemas"]["MaterialConfig"] | null;
            mesh?: components["schemas"]["MeshConfig"] | null;
            /** @description Elastic linear modes to keep. Default: 30. */
            n_modes?: number;
            /** @description A name for people; need not be unique. */
            name?: string | null;
            /** @description Candidate stitch pairs to prepare ahead (zero-based vertices). */
            seams?: number[][];
            /** @description How many times as stiff each tet is as the material of its domain; empty if all are alike. */
            tet_stiffness?: number[];
        };
        /**
         * @description A session. Counts that a build has yet to find are 0, and lists empty, while `state` is
         *     `building` or `failed`, and while the body is not in memory: `stored` or `restoring`.
         */
        SessionInfo: {
            /** @description Columns of the basis. */
            basis_size: number;
            error?: components["schemas"]["Problem"] | null;
            /** @description Frequencies of the elastic modes in Hz, ascending. */
            frequencies_hz: number[];
            /**
             * Format: int64
             * @description The current generation.
             */
            generation: number;
            /** @description The session's identifier. */
            id: string;
            /**
             * Format: int64
             * @description Bytes the session holds, parts shared with other sessions included.
             */
            memory_bytes: number;
            /** @description Connected pieces of the unstitched mesh. */
            n_components: number;
            /** @description Cubature points; `null` when every tet is summed. */
            n_cubature_points?: number | null;
            /** @description Distinct domain labels of the mesh. */
            n_domains: number;
            /** @description Three times the number of vertices that may move. */
            n_free_dofs: number;
            /** @description Elastic modes kept. */
            n_modes: number;
            /** @description Candidate pairs that are prepared: edits of them take no sparse solve. */
            n_prepared_pairs: number;
            /** @description Rigid motions that cost no energy, with the stitches in force. */
            n_rigid_modes: number;
            /** @description Stitches in force. */
            n_stitches: number;
            /** @description Tets of the mesh. */
            n_tets: number;
            /** @description Vertices of the mesh. */
            n_vertices: number;
            /** @description The name it was given. */
            name?: string | null;
            /**
             * Format: int64
             * @description The oldest generation that is still kept, while the body is in memory.
             */
            oldest_generation?: number | null;
            parameters?: components["schemas"]["SessionParameters"] | null;
            /**
             * Format: double
             * @description How much of that stage is done, 0 to 1; 1 when nothing is in progress.
             */
            progress: number;
            /** @description The stage of the build or rebuild in progress. */
            stage?: string | null;
            /** @description What it is doing. */
            state: components["schemas"]["SessionState"];
            /**
             * @description Whose it is, where the daemon asks for keys: what is published of it over Zenoh lies below
             *     `sutura/v1/tenants/{tenant}`.
             */
            tenant?: string | null;
            /** @description Time spent in each stage of the build or rebuild that made the current generation, in ms. */
            timings_ms: {
                [key: string]: number;
            };
            /** @description What the caller should know about the current generation, in words. */
            warnings: string[];
        };
        /** @description One page of sessions, in the order in which they were made. */
        SessionList: {
            /** @description Pass as `?after=` to get the next page; `null` on the last one. */
            next?: string | null;
            /** @description The sessions of this page. */
            sessions: components["schemas"]["SessionInfo"][];
        };
        /** @description The parameters a session was built with, every default filled in. */
        SessionParameters: {
            /** @description The basis asked for. */
            basis: components["schemas"]["BasisConfig"];
            cubature?: components["schemas"]["CubatureConfig"] | null;
            /** @description Rayleigh damping. */
            damping: components["schemas"]["DampingConfig"];
            /** @description The material of each domain, by label. */
            domain_materials: {
                [key: string]: components["schemas"]["MaterialConfig"];
            };
            /** @description How mass is distributed. */
            mass: components["schemas"]["MassConfig"];
            /** @description How many vertices are fixed. */
            n_fixed_vertices: number;
            /** @description Elastic modes asked for. */
            n_modes: number;
            /** @description How many candidate pairs are prepared ahead. */
            n_seam_pairs: number;
        };
        /**
         * @description What a session is doing.
         * @enum {string}
         */
        SessionState: "building" | "ready" | "rebuilding" | "failed" | "stored" | "restoring";
        /** @description How a session is simulated. */
        SimulationConfig: {
            /**
             * @description How obstacles push back.
             * @default {
             *       "damping_s_m": 1,
             *       "friction": 0.3
             *     }
             */
            contact?: components["schemas"]["ContactConfig"];
            /**
             * Format: double
             * @description Time step in s. Default: 0.01.
             * @default 0.01
             */
            dt_s?: number;
            /**
             * @description Gravity in m/s². Default: (0, −9.81, 0).
             * @default [
             *       0,
             *       -9.81,
             *       0
             *     ]
             */
            gravity_m_s2?: number[];
            /**
             * @description The integrator. Default: `implicit_newmark`.
             * @default implicit_newmark
             */
            integrator?: components["schemas"]["IntegratorConfig"];
            /**
             * @description What the body cannot enter. Default: nothing.
             * @default []
             */
            obstacles?: components["schemas"]["Obstacle"][];
            /**
             * Format: double
             * @description States published per second. Default: 60.
             * @default 60
             */
            publish_hz?: number;
            /**
             * Format: double
             * @description Relative error of the deformation that a step may add, by estimate: steps with more of it are split, into 64 parts
             *     at most. Between 0 and 1. Default: none, steps are split only where they cannot be solved.
             * @default null
             */
            substep_tolerance?: number | null;
        };
        /** @description A running simulation. */
        SimulationInfo: {
            /** @description How it runs, defaults filled in. */
            config: components["schemas"]["SimulationConfig"];
            /**
             * Format: int64
             * @description The generation it steps.
             */
            generation: number;
            /** @description The sum of what grabs and obstacles pull with, in N. */
            interaction_force_n: number[];
            /** @description Forces acting now. */
            n_forces: number;
            /** @description Grabs that hold on. */
            n_grabs: number;
            /**
             * Format: int64
             * @description Steps that could not be taken in time: simulated time fell behind by so many `dt_s`.
             */
            n_late: number;
            /**
             * Format: int64
             * @description Steps that had to be undone, the body brought to rest.
             */
            n_recovered: number;
            /**
             * Format: int64
             * @description Steps taken.
             */
            n_steps: number;
            /**
             * Format: int64
             * @description The number of the latest published state.
             */
            sequence: number;
            /**
             * Format: double
             * @description Simulated time in s.
             */
            time_s: number;
        };
        /**
         * @description Where the modes of a generation come from.
         * @enum {string}
         */
        Verdict: "patched" | "refined" | "rebuilt";
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type $defs = Record<string, never>;
export type operations = Record<string, never>;
