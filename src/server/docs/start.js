SwaggerUIBundle({
    url: "/openapi.json",
    dom_id: "#swagger-ui",
    deepLinking: true,
    displayRequestDuration: true,
    // Shapes are shown with the routes that use them; the list of all of them starts folded.
    defaultModelsExpandDepth: 0,
    // Nothing is sent to a validator elsewhere.
    validatorUrl: null,
});
